# SPDX-License-Identifier: Apache-2.0
"""`fjr gains`: synthesise gains, print them as a block of YAML for a scenario or write them into its file."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from fjr_core.config.law import gain_values, robust_action
from fjr_core.config.scenario import Scenario
from fjr_core.errors import GainsError, prefixed
from fjr_core.files import importing
from fjr_core.files.text_file import read_text, write_text
from fjr_core.law.interfaces import SampledLaw, StaticLaw
from fjr_core.law.linearized import equilibria_at
from fjr_core.law.rate import Rate
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.configuration_sampling import checked_configurations
from fjr_core.motions.domain import joint_range
from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import at_least
from fjr_core.robust.law import sampled_law
from fjr_design.stability.sampled_loop import SampledCheck, check
from fjr_design.tuning.gain_synthesis import synthesize
from fjr_design.uncertainty.drawn_loops import (
    CONFIDENCE,
    DrawnLoops,
    DrawnPlants,
    draws_needed,
    in_common,
    largest_share,
)
from fjr_design.uncertainty.posterior import DELAY, MATRICES, UNKNOWN, drawn_plants, read_identification
from fjr_msgs_py.console.output import Result, progress_bar, tell
from fjr_msgs_py.scenarios import installed, library
from fjr_msgs_py.scenarios.gains_block import gain_lines, with_gains
from fjr_msgs_py.scenarios.library import ScenarioError

DESIGN_DRAWS, WIDER = 200, 1.5  # from the posterior with standard deviations this many times as large
SHARE = 1e-3  # largest share of lost plants that fresh draws are to exclude
PROGRESS = "{desc}: {percentage:3.0f}% |{bar}|"


def synthesised(
    scenario: str | None,
    assignments: Sequence[str],
    beta: float,
    delay: float,
    everywhere: bool,
    proven: bool,
    write: bool,
    identification: Path | None,
    seed: int,
) -> Result:
    """Return gains for a scenario's robot as YAML: rate beta [1/s] at its sample rate and a loop delay [samples].

    The rate holds along the scenario's reference, or everywhere within the joints' range. proven: it holds for all
    positions near the reference or in the range, not only for the sampled ones. write: replace the gains in
    the scenario's file. identification: file of a posterior; the loop is then stable with plants drawn from it, and
    checked on fresh draws. Raises GainsError if no such gains exist or a fresh draw is unstable.
    """
    if write and scenario in installed("scenarios"):
        raise ScenarioError(f"'{scenario}' is an installed scenario; expected a file of your own for --write")
    path = library.find(scenario)
    loaded = library.load(scenario, assignments, robot_only=True)
    robot, period = loaded.robot, loaded.sample_period
    where = None if everywhere else loaded.configurations()
    posterior = Posterior(identification, loaded, seed) if identification else None
    design, domain = posterior.design if posterior else None, None
    if proven:
        prover = importing.module("fjr_proofs.kept_rate")
        prover.refuse_unprovable(loaded)
        domain = joint_range(robot) if everywhere else prover.near_reference(loaded)[0]
    gains = synthesize(robot, beta, period, delay * period, where, loaded.joints, design, domain)
    law = TrackingLaw(robot, gains)
    sampled = sampled_law(law, robust_action(loaded.controller_values, law))
    found, rate = _checked(loaded, sampled, delay * period, where), law.rate(where)
    confirmed, counted = posterior.confirmed(sampled, found, where) if posterior else ("", {})
    head = _head(loaded, rate, found, everywhere, beta if proven else None)
    head += f"# {confirmed}\n" if confirmed else ""
    numbers = {"beta_per_s": rate.beta, "beta_is_proven": rate.proven, "spectral_radius": found.spectral_radius}
    numbers |= {"delay_margin_samples": found.delay_margin, **counted}
    values = {name.partition(".")[2]: entries for name, entries in gain_values(gains, robot.n).items()}
    if write:
        with prefixed(f"{path}: "):
            write_text(path.resolve(), with_gains(read_text(path), values, robot.n))
    where_to = f"# written to {path}:" if write else "# in place of `gains` below ros__parameters:"
    block = "\n".join([f"{head}{where_to}", "    gains:", *gain_lines(values, robot.n, indent=6)])
    return Result(block, {"scenario": loaded.name, **numbers, "gains": values, "written": path if write else None})


def _head(scenario: Scenario, rate: Rate, found: SampledCheck, everywhere: bool, proven: float | None) -> str:
    """Return the comment above the gains; proven [1/s]: rate for which a proof bounds the inertia, None without one."""
    place, basis = "everywhere" if everywhere else "along its reference", "proven" if rate.proven else "sampled"
    head = (
        f"# for {scenario.name} {place}: beta {at_least(rate.beta, 3)} 1/s ({basis}); "
        f"at {1 / scenario.sample_period:g} Hz spectral radius {found.spectral_radius:.4f}, "
        f"delay margin {found.delay_margin:.2f} samples\n"
    )
    if proven is None:
        return head
    place = "over the joint range" if everywhere else "near the reference (see `fjr check`)"
    least = at_least(proven, 3)
    return f"{head}# the inertia is bounded by a proof {place}: beta is at least {least} 1/s there before rounding\n"


def _checked(scenario: Scenario, law: SampledLaw, delay: float, where: Array | None) -> SampledCheck:
    """Check a law with the scenario's observer and sensors; raise GainsError if unstable."""
    found = check(law, scenario.sample_period, delay, where, None, scenario.sensing, lowest_rate=False)
    if not found.stable:
        raise GainsError(
            f"the spectral radius with the scenario's robust.* options and observer is {found.spectral_radius:.4g}; "
            "expected less than 1: try a lower rate, lower robust.* gains or a faster observer"
        )
    return found


class Posterior:
    """Plants drawn from the identification in a file, for the robot of a scenario; raises ParameterError."""

    def __init__(self, path: Path, scenario: Scenario, seed: int) -> None:
        self._found = read_identification(path)
        self._found.check_joints(scenario.joints)
        self._scenario, self._seed = scenario, seed
        unknown = [one for one in self._found.estimates if one.verdict == UNKNOWN and one.name in (*MATRICES, DELAY)]
        self.kept = [f"{one.name} of {one.joint}" if one.joint else one.name for one in unknown]
        if self.kept:
            tell(f"not identifiable, so not drawn: {', '.join(self.kept)}")

    @cached_property
    def design(self) -> DrawnPlants:
        """Return the plants of the synthesis, from a posterior that is WIDER."""
        return drawn_plants(self._found, self._scenario.robot, DESIGN_DRAWS, 2 * self._seed, WIDER)

    def confirmed(self, law: SampledLaw, found: SampledCheck, where: Array | None) -> tuple[str, dict[str, Any]]:
        """Check a law, found stable with its own model, on fresh draws; raise GainsError if one is unstable.

        It is checked at the configurations that are worst for some of the design draws; with a controller state, of
        those at which it was found stable. Return what the draws say, with which confidence, as sentence and JSON.
        """
        count = draws_needed(SHARE)
        fresh = drawn_plants(self._found, self._scenario.robot, count, 2 * self._seed + 1)
        sensing, plain = self._scenario.sensing, isinstance(law, StaticLaw) and self._scenario.sensing.plain
        equilibria = equilibria_at(law.robot, checked_configurations(law.robot, where if plain else found.closely))
        worst = DrawnLoops(law, equilibria, found.sample_period, found.delay, sensing).worst(self.design)
        loops = DrawnLoops(law, equilibria.at(worst), found.sample_period, found.delay, sensing)
        with progress_bar(f"checking {count:,} fresh draws", PROGRESS, total=1.0, desc="fresh draws") as bar:
            unstable = loops.unstable(fresh, lambda share: bar.update(share - bar.n))
        lost = int(unstable.sum())
        share, sure = largest_share(lost, count), f"with {100 * CONFIDENCE:g} %"
        if lost:
            which = f", and {in_common(fresh, unstable, self._scenario.joints)}" if lost < count else ""
            raise GainsError(
                f"{lost} of {count:,} robots drawn afresh from the identification are unstable (at most "
                f"{100 * share:.2g} % {sure}){which}; expected none: try a lower rate, or narrower intervals from a "
                "record of more motion (fjr excite)"
            )
        numbers = {"fresh_draws": count, "lost_draws": 0, "largest_lost_share": share, "confidence": CONFIDENCE}
        sentence = (
            f"0 of {count:,} robots drawn afresh from the identification are unstable, at the {len(worst)} worst "
            f"configurations: at most {100 * share:.2g} % {sure}"
        )
        return sentence, {**numbers, "not_drawn": self.kept}
