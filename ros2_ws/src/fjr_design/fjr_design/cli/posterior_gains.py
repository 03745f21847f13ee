# SPDX-License-Identifier: Apache-2.0
"""Gains of an identified robot: design draws from its posterior, and fresh draws that confirm the gains."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from fjr_core.config.law import robust_action
from fjr_core.config.scenario import Scenario
from fjr_core.errors import GainsError
from fjr_core.law.linearized import equilibria_at
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.configuration_sampling import checked_configurations
from fjr_core.numerics.checks import Array
from fjr_core.robust.law import sampled_law
from fjr_design.uncertainty.drawn_loops import (
    CONFIDENCE,
    DrawnLoops,
    DrawnPlants,
    LargestMeanDifference,
    draws_needed,
    largest_share,
)
from fjr_design.uncertainty.posterior import (
    MATRICES,
    drawn_plants,
    read_identification,
)
from fjr_msgs_py.console.output import progress_bar

from ..uncertainty.posterior import DELAY

DESIGN_DRAWS, WIDER = 200, 1.5  # from the posterior with standard deviations this many times as large
SHARE = 1e-3  # largest share of lost plants that fresh draws are to exclude
PROGRESS = "{desc}: {percentage:3.0f}% |{bar}|"


@dataclass(frozen=True)
class Confirmed:
    """Fresh draws none of which is unstable, and at how many configurations."""

    draws: int
    configurations: int
    kept: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """Return what the draws say, and with which confidence."""
        share = largest_share(0, self.draws)
        return (
            f"0 of {self.draws:,} robots drawn afresh from the identification are unstable, at the "
            f"{self.configurations} worst configurations: at most {100 * share:.2g} % with {100 * CONFIDENCE:g} %"
        )

    @property
    def numbers(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        share = largest_share(0, self.draws)
        return {
            "fresh_draws": self.draws,
            "lost_draws": 0,
            "largest_lost_share": share,
            "confidence": CONFIDENCE,
            "not_drawn": list(self.kept),
        }


class Posterior:
    """Plants drawn from the identification in a file, for the robot of a scenario; raises ParameterError."""

    def __init__(self, path: Path, scenario: Scenario, seed: int) -> None:
        self._found = read_identification(path)
        self._found.check_joints(scenario.joints)
        self._scenario, self._seed = scenario, seed
        self.kept = tuple(self._found.kept_at_prior((*MATRICES, DELAY)))
        if self.kept:
            print(f"fjr: not identifiable, so not drawn: {', '.join(self.kept)}", file=sys.stderr)

    @cached_property
    def design(self) -> DrawnPlants:
        """Return the plants of the synthesis, from a posterior that is WIDER."""
        return drawn_plants(self._found, self._scenario.robot, DESIGN_DRAWS, 2 * self._seed, WIDER)

    def confirmed(self, law: TrackingLaw, delay: float, where: Array | None) -> Confirmed:
        """Check the law with robust.* options and sensing on fresh draws; raise GainsError if one is unstable."""
        count = draws_needed(SHARE)
        fresh = drawn_plants(self._found, self._scenario.robot, count, 2 * self._seed + 1)
        loops, configurations = self._loops(law, delay, where)
        with progress_bar(f"checking {count:,} fresh draws", PROGRESS, total=1.0, desc="fresh draws") as bar:
            unstable = loops.unstable(fresh, lambda share: bar.update(share - bar.n))
        if lost := int(unstable.sum()):
            which = f", and {LargestMeanDifference.of(fresh, unstable).sentence(self._scenario.joints)}"
            which = which if lost < count else ""
            raise GainsError(
                f"{lost} of {count:,} robots drawn afresh from the identification are unstable (at most "
                f"{100 * largest_share(lost, count):.2g} % with {100 * CONFIDENCE:g} %){which}; expected none: try "
                "a lower rate, or narrower intervals from a record of more motion (fjr excite)"
            )
        return Confirmed(count, configurations, self.kept)

    def _loops(self, law: TrackingLaw, delay: float, where: Array | None) -> tuple[DrawnLoops, int]:
        """Return the loops at the configurations that are worst for some of the design draws."""
        scenario = self._scenario
        equilibria = equilibria_at(law.robot, checked_configurations(law.robot, where))
        sampled = sampled_law(law, robust_action(scenario.controller_values, law))
        worst = DrawnLoops(law, equilibria, scenario.sample_period, delay).worst(self.design)
        return DrawnLoops(sampled, equilibria.at(worst), scenario.sample_period, delay, scenario.sensing), len(worst)
