# SPDX-License-Identifier: Apache-2.0
"""Tune a law of a comparison to stated uncertainties, all laws by the same cost, draws and number of candidates."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from fjr_core.config.parameter import number
from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_core.errors import ParameterError
from fjr_core.law.interfaces import SampledLaw

from ..monte_carlo import distributions
from ..monte_carlo.distributions import FIXED, Distribution
from ..monte_carlo.sweep import Sweep
from ..tuning.candidates import SELECTION, Point, Range, TuningStudy, with_better_start
from ..tuning.goal import Goal, Score
from ..tuning.search import FINALISTS, search
from .motion_demand import MotionDemand
from .perturbations import known, numerically_stable

MAPPINGS = ("vary", "imperfections", "minimise")
MOST = 10**6  # candidates, draws
LONGEST = 600.0  # s
OUTER = 0.95  # quantile that is reported beside the median


@dataclass(frozen=True)
class Uncertainties:
    """What every law is tuned for. vary: distributions as in a sweep file. imperfections: levels of perturbations.

    minimise, quantile, success: see Goal. candidates, draws, fresh, seed: see TuningStudy. duration, settle_after [s].
    Raises ParameterError, CompareError.
    """

    vary: Mapping[str, Any] = field(default_factory=dict)
    imperfections: Mapping[str, float] = field(default_factory=dict)
    minimise: Mapping[str, float] = field(default_factory=lambda: {"rms": 1.0})
    quantile: float = 0.5
    success: float = 0.95
    candidates: int = 150
    draws: int = 24
    fresh: int = 400
    seed: int = 1
    duration: float = 3.0
    settle_after: float = 1.0

    def __post_init__(self) -> None:
        for name in ("candidates", "draws", "fresh"):
            if not (float(getattr(self, name)).is_integer() and 1 <= getattr(self, name) <= MOST):
                raise ParameterError(f"'{name}' is {getattr(self, name)}; expected 1 to {MOST}")
        if not 0 <= self.settle_after < self.duration <= LONGEST:
            raise ParameterError(
                f"'settle_after' is {self.settle_after} and 'duration' {self.duration} s; expected 0 to less than the "
                f"duration, and this at most {LONGEST:g} s"
            )
        for name, given in self.vary.items():
            distributions.read(name, given)
        for name, level in self.imperfections.items():
            known(name).checked(level)
        Goal(self.minimise, self.quantile, self.success)


@dataclass(frozen=True, eq=False)
class LawFor:
    """A law with the parameters that were chosen, a summary, and its figures on fresh draws."""

    law: SampledLaw
    parameters: Mapping[str, Any]
    sentence: str
    figures: Mapping[str, float | None]


def uncertainties(section: Mapping[str, Any]) -> Uncertainties:
    """Return the uncertainties of the section `tune` of a comparison; raises ParameterError, CompareError."""
    names = [each.name for each in fields(Uncertainties)]
    for key in section:
        if key not in names:
            close = difflib.get_close_matches(str(key), names, n=1)
            raise ParameterError(f"has '{key}'; expected {close[0] if close else 'some of ' + ', '.join(names)}")
    for key, value in section.items():
        if key in MAPPINGS and not isinstance(value, Mapping):
            raise ParameterError(f"'{key}' is {value!r}; expected a mapping")
        if key not in MAPPINGS and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise ParameterError(f"'{key}' is {value!r}; expected a number")
    return Uncertainties(**section)


def law_for(
    text: str,
    wanted: Uncertainties,
    demand: MotionDemand,
    effort_limit: Sequence[float],
    tracks: float,
    on_progress: Callable[[float], None] = lambda share: None,
) -> LawFor:
    """Return the law of a scenario, given as its text, tuned to uncertainties. Raises FjrError.

    demand: of the motion, for the levels. effort_limit (n,) [N m]: of every command. tracks: a run succeeds if its
    error is at most this fraction of the motion, at every joint. on_progress: called with the share done, 0 to 1.
    """
    study = with_better_start(_study(text, wanted, demand, effort_limit, tracks))
    total = wanted.draws * (wanted.candidates + (FINALISTS + 1) * SELECTION)
    done = 0

    def evaluate(points: Sequence[Point], runs: Range) -> list[Score]:
        nonlocal done
        done += len(points) * (runs[1] - runs[0])
        scores = [study.score(point, study.run(point, *runs)) for point in points]
        on_progress(min(1.0, done / total))
        return scores

    found = search(study, evaluate)
    fresh = study.run(found.chosen, *study.fresh_runs)
    score = study.score(found.chosen, fresh)
    outer = float(np.quantile(fresh["rms"], OUTER, method="inverted_cdf"))
    shown = {"rms": score.figures["rms"], "rms_outer": outer, "success": score.success}
    shown |= {name: score.figures[name] for name in ("effort_noise", "effort_peak")}
    sentence = (
        f"best of {len(found.candidates)} candidates; on {wanted.fresh} fresh draws {100 * score.success:.3g} % track"
    )
    return LawFor(
        study.coordinates.controller(found.chosen)[0],
        study.coordinates.values(found.chosen),
        sentence,
        {name: value if np.isfinite(value) else None for name, value in shown.items()},
    )


def _study(
    text: str, wanted: Uncertainties, demand: MotionDemand, effort_limit: Sequence[float], tracks: float
) -> TuningStudy:
    scenario = parse_scenario("tuned", text)
    vary = {name: distributions.read(name, given) for name, given in wanted.vary.items()}
    vary |= {"effort_limit": Distribution(FIXED, tuple(effort_limit)), **_levels(wanted, demand, scenario)}
    sweep = Sweep(
        "tuned",
        text,
        1,
        vary,
        duration=wanted.duration,
        settle_after=wanted.settle_after,
        seed=wanted.seed,
        success={"rms": tracks * demand.motion},
    )
    goal = Goal(wanted.minimise, wanted.quantile, wanted.success)
    return TuningStudy(sweep, goal, wanted.draws, wanted.candidates, wanted.fresh)


def _levels(wanted: Uncertainties, demand: MotionDemand, scenario: Scenario) -> dict[str, Distribution]:
    """Return the levels of the perturbations as fixed values of a sweep."""
    step = scenario.sample_period / number(scenario.plant_values, "inner_steps")
    parts = [known(name).fields(level, demand, step) for name, level in wanted.imperfections.items()]
    merged = numerically_stable({key: value for part in parts for key, value in part.items()})
    return {name: Distribution(FIXED, tuple(np.atleast_1d(value).tolist())) for name, value in merged.items()}
