# SPDX-License-Identifier: Apache-2.0
"""`fjr check --prove-sampled`: prove that the sampled loop of a scenario contracts near its reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fjr_core.config.scenario import Scenario
from fjr_core.errors import FjrError
from fjr_core.law.robust import Robust
from fjr_core.law.vdpbc.law import TrackingLaw
from fjr_core.numerics.one_line import at_least, at_most
from fjr_msgs_py.console.output import progress_bar
from fjr_proofs.sampled_contraction.proof import SampledContraction, sampled_contraction

PROGRESS = "{desc}: {percentage:3.0f}% |{bar}|"
ROW = "sampled loop"


@dataclass(frozen=True)
class SampledProof:
    """The proof, or why there is none."""

    found: SampledContraction | None
    reason: str = ""
    unit: str = "rad"

    @property
    def rows(self) -> dict[str, str]:
        """Return the row of `fjr check`."""
        if self.found is None:
            return {ROW: f"NOT proven: {self.reason}"}
        tube, offset = (1e3 * float(each.max()) for each in (self.found.tube, self.found.offset))
        decay = f"contracts at {at_least(self.found.rate)} 1/s within {at_least(tube)} m{self.unit} of the reference"
        return {
            f"{ROW}, proven": f"{decay}, {_delay(self.found.least_delay, self.found.longest_delay)}",
            "    remaining error": f"at most {at_most(offset, 2)} m{self.unit} of a link",
        }

    @property
    def values(self) -> dict[str, Any]:
        """Return the numbers as JSON values."""
        if self.found is None:
            return {"proven": False, "reason": self.reason}
        return {
            "proven": True,
            "rate": self.found.rate,
            "tube": self.found.tube.tolist(),
            "offset": self.found.offset.tolist(),
            "delay_samples": [self.found.least_delay, self.found.longest_delay],
            "sample_period_s": self.found.sample_period,
        }


def sampled_proof(scenario: Scenario, delay: float | None) -> SampledProof:
    """Prove contraction of the loop of a scenario with all delays up to `delay` samples; None: with its own delay."""
    reason, law = not_covered(scenario), scenario.law
    if reason or not isinstance(law, TrackingLaw):
        return SampledProof(None, reason)
    period = scenario.sample_period
    own = scenario.loop_delay / period
    delays = (own, own) if delay is None else (0.0, delay)
    try:
        with progress_bar("proving contraction of the sampled loop", PROGRESS, total=1.0, desc="proof") as bar:
            found = sampled_contraction(
                law, scenario.reference, period, delays, lambda share: bar.update(share - bar.n)
            )
    except FjrError as error:
        return SampledProof(None, str(error))
    unit = " or m".join(dict.fromkeys(each.position for each in scenario.robot.units))
    return SampledProof(found, f"no tube found about the reference, {_delay(*delays)}", unit)


def not_covered(scenario: Scenario) -> str:
    """Return why the proof does not apply to a scenario; empty if it may."""
    robust, sensing = getattr(scenario.sampled_law, "robust", Robust()), scenario.sensing
    causes = {
        f"law.type is {scenario.controller_values['law.type']}; expected v_dpbc": not isinstance(
            scenario.law, TrackingLaw
        ),
        "robust.* gives the law a state; expected a law without one": robust.estimates
        or robust.integrates
        or robust.predicts,
        "measurement.* adds an observer or torque sensors; expected measured states": not sensing.plain,
        "plant and law have different robots; expected equal ones": not scenario.plant_is_the_model,
    }
    return next((sentence for sentence, applies in causes.items() if applies), "")


def _delay(least: float, longest: float) -> str:
    """Return delays [samples] in words."""
    if not longest:
        return "without delay"
    return f"delay {'up to' if least < longest else 'of'} {longest:g} sample{'' if longest == 1 else 's'}"
