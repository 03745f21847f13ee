# SPDX-License-Identifier: Apache-2.0
"""Evaluate candidates of a search: the compiled loop of a sweep with the gains of any point, nothing compiled again."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from fjr_core.errors import FjrError, ParameterError
from fjr_core.law.interfaces import SampledLaw
from fjr_core.runtime.velocity_observer import VelocityObserver
from fjr_core.stability.sampled_loop import spectral_radius

from ..monte_carlo.sweep import Sweep, from_text
from .coordinates import RULE, SCENARIO, Coordinates, coordinates, starts
from .goal import Figures, Goal, Score, figures

FEW = 4  # configurations of the reference at which a loop is checked
FINER = 2.0  # delays that are checked per sample
SELECTION = 4  # times the draws of the search: those of the selection
Point = tuple[float, ...]
OF_SCENARIO: Point = ()
"""Point that stands for the gains of the scenario, wherever the search starts."""
Range = tuple[int, int]


@dataclass(frozen=True)
class TuningStudy:
    """A search of gains for a goal over the draws of a sweep.

    start: of the search, see coordinates.starts. draws: runs of each candidate. candidates: number of them. fresh: runs
    of the validation. Runs are numbered: the first `draws` are those of the search, the next ones those of the
    selection, then those of the validation, so that each stage sees draws that no earlier one has seen. The seed is
    that of the sweep. Raises ParameterError.
    """

    sweep: Sweep
    goal: Goal = field(default_factory=Goal)
    draws: int = 48
    candidates: int = 300
    fresh: int = 1000
    start: str = SCENARIO

    def __post_init__(self) -> None:
        for name in ("draws", "candidates", "fresh"):
            if not 1 <= getattr(self, name) <= 10**7:
                raise ParameterError(f"'{name}' is {getattr(self, name)}; expected 1 to {10**7}")

    @cached_property
    def coordinates(self) -> Coordinates:
        """Search space of the scenario's law."""
        return coordinates(self.sweep.scenario, self.start)

    @property
    def origin(self) -> Point:
        """Point of the start."""
        return (0.0,) * len(self.coordinates)

    @property
    def search_runs(self) -> Range:
        """Runs of the search, as (begin, end)."""
        return 0, self.draws

    @property
    def selection_runs(self) -> Range:
        """Runs of the selection of a candidate."""
        return self.draws, (1 + SELECTION) * self.draws

    @property
    def fresh_runs(self) -> Range:
        """Runs of the validation."""
        begin = self.selection_runs[1]
        return begin, begin + self.fresh

    def run(self, point: Sequence[float], begin: int, end: int) -> Figures:
        """Return the figures of the runs begin .. end - 1 with the gains at a point; none if no such gains exist."""
        first = self.sweep.loop
        try:
            loop = first.with_law(*self._controller(point))
        except FjrError:
            return {}
        outcomes = loop.run(self.sweep.draws(begin, end))
        return figures(outcomes, self.sweep.succeeded(outcomes))

    def score(self, point: Sequence[float], runs: Figures) -> Score:
        """Return the score of a point from its runs."""
        if not runs:
            return self.goal.refused()
        return self.goal.score(runs, self._instability(self._controller(point)[0]))

    def _controller(self, point: Sequence[float]) -> tuple[SampledLaw, VelocityObserver | None]:
        return self.coordinates.controller(point) if len(point) else (self.sweep.scenario.sampled_law, None)

    def _instability(self, law: SampledLaw) -> float:
        """Return how far the spectral radius exceeds 1 with a delay within the required margin; 0 if it does not."""
        margin = self.goal.delay_margin
        if not margin:
            return 0.0
        scenario, delays = self.sweep.scenario, np.linspace(0.0, margin, int(np.ceil(FINER * margin)) + 1)
        where, period = scenario.configurations(FEW), scenario.sample_period
        each = [
            spectral_radius(law, period, delay * period, where, scenario.plant, scenario.sensing) for delay in delays
        ]
        return max(0.0, float(np.max(each)) - 1)

    @property
    def text(self) -> str:
        """Study as JSON; studies with equal text have equal results."""
        numbers = {name: getattr(self, name) for name in ("draws", "candidates", "fresh")}
        goal = {"goal": asdict(self.goal), "start": self.start}
        return json.dumps({**json.loads(self.sweep.text), **goal, **numbers}, indent=1)


def with_better_start(
    study: TuningStudy, run: Callable[[TuningStudy, Point, int, int], Figures] = TuningStudy.run
) -> TuningStudy:
    """Return the study with the start that costs less on the draws of the search; run: runs a part of a point."""

    def cost(one: TuningStudy) -> float:
        return one.score(one.origin, run(one, one.origin, *one.search_runs)).cost

    if RULE in starts(study.sweep.scenario):
        with suppress(FjrError):  # the rule may have no gains for this robot; another error comes again in the search
            return min(study, replace(study, start=RULE), key=cost)
    return study


def study_of(text: str) -> TuningStudy:
    """Return the study described by TuningStudy.text."""
    values: dict[str, Any] = json.loads(text)
    goal, start = Goal(**values.pop("goal")), values.pop("start")
    numbers = {name: values.pop(name) for name in ("draws", "candidates", "fresh")}
    return TuningStudy(from_text(json.dumps(values)), goal, **numbers, start=start)


_recent = lru_cache(maxsize=2)(study_of)
_building = threading.Lock()


def run_candidate(text: str, point: Point, begin: int, end: int) -> Figures:
    """Run a part of the runs of a point of a study given as text, in a local or remote worker; see TuningStudy.run."""
    with _building:  # once for all threads of a process
        study = _recent(text)
        study.sweep.loop.build()
        _ = study.coordinates
    return study.run(point, begin, end)
