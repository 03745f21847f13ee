# SPDX-License-Identifier: Apache-2.0
"""Gains of an identified robot: design draws from its posterior, and fresh draws that confirm the gains."""

from __future__ import annotations

import sys
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
    draws_needed,
    in_common,
    largest_share,
)
from fjr_design.uncertainty.posterior import DELAY, MATRICES, drawn_plants, read_identification
from fjr_msgs_py.console.output import progress_bar

DESIGN_DRAWS, WIDER = 200, 1.5  # from the posterior with standard deviations this many times as large
SHARE = 1e-3  # largest share of lost plants that fresh draws are to exclude
PROGRESS = "{desc}: {percentage:3.0f}% |{bar}|"


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

    def confirmed(self, law: TrackingLaw, delay: float, where: Array | None) -> tuple[str, dict[str, Any]]:
        """Check the law with robust.* options and sensing on fresh draws; raise GainsError if one is unstable.

        Return what the draws say, and with which confidence, as a sentence and as JSON values.
        """
        count = draws_needed(SHARE)
        fresh = drawn_plants(self._found, self._scenario.robot, count, 2 * self._seed + 1)
        loops, configurations = self._loops(law, delay, where)
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
            f"0 of {count:,} robots drawn afresh from the identification are unstable, at the {configurations} worst "
            f"configurations: at most {100 * share:.2g} % {sure}"
        )
        return sentence, {**numbers, "not_drawn": list(self.kept)}

    def _loops(self, law: TrackingLaw, delay: float, where: Array | None) -> tuple[DrawnLoops, int]:
        """Return the loops at the configurations that are worst for some of the design draws."""
        scenario = self._scenario
        equilibria = equilibria_at(law.robot, checked_configurations(law.robot, where))
        sampled = sampled_law(law, robust_action(scenario.controller_values, law))
        worst = DrawnLoops(law, equilibria, scenario.sample_period, delay).worst(self.design)
        return DrawnLoops(sampled, equilibria.at(worst), scenario.sample_period, delay, scenario.sensing), len(worst)
