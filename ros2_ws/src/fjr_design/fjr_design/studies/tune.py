# SPDX-License-Identifier: Apache-2.0
"""Tune gains for stated uncertainties: a goal over drawn plants, candidates in one compiled loop, and their search.

The search is CMA-ES (package cma), which asks for candidates and is told their costs: N. Hansen, A. Ostermeier,
"Completely derandomized self-adaptation in evolution strategies", Evolutionary Computation 9 (2001) 159-195. Costs
enter by their ranks only, so that constraints need no weights: every point that violates one ranks behind all that do
not. The search runs on a few draws, the same for all candidates. The best of them are then compared on other draws,
since the best of many on a few draws is partly luck.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from fjr_core.errors import PIP, FjrError, ParameterError
from fjr_core.law.interfaces import SampledLaw
from fjr_core.numerics.checks import Array
from fjr_core.runtime.velocity_observer import VelocityObserver
from fjr_core.stability.linearization import spectral_radius

from .coordinates import RULE, SCENARIO, SearchCoordinates, coordinates
from .sections import Reader, between, subsection, whole
from .study import Columns, Study
from .sweep import FIGURES, SUCCESS, Figures, Sweep, figures

INFEASIBLE = 1e6  # cost of points that violate a constraint, at least; the cost of others is far below
WORST = 1e3  # violation that counts at most
TIES = 1e3  # largest part of the cost among points with the same violation
FEW = 4  # configurations of the reference at which a loop is checked
FINER = 2.0  # delays that are checked per sample
SELECTION = 4  # times the draws of the search: those of the selection
Point = tuple[float, ...]
OF_SCENARIO: Point = ()  # point that stands for the gains of the scenario, wherever the search starts
Range = tuple[int, int]
FIRST_DEVIATION = 0.4  # of the logarithms of the factors: e^0.4 = 1.5
WIDEST = float(np.log(50.0))  # of the logarithms of the factors
FINALISTS = 6  # candidates of the search that the selection compares


@dataclass(frozen=True)
class Score:
    """Figures at the quantile of the goal, share of successful runs, margin and cost of one candidate.

    violation: 0 if all constraints are kept, else how much is missing, relative to what is required. cost: what the
    search minimises; it is more than INFEASIBLE with a violation.
    """

    figures: Mapping[str, float]
    success: float
    violation: float
    cost: float

    @property
    def feasible(self) -> bool:
        """Return whether all constraints are kept."""
        return self.violation <= 0


@dataclass(frozen=True)
class Goal:
    """Cost: the sum of weight * log(quantile of a figure over the draws). Constraints:

    success: share of the draws that succeed (see Sweep). limits: largest quantile of a figure. delay_margin [samples]:
    the sampled loop is stable with every delay up to it, at the equilibria of a few configurations of the reference.
    """

    minimise: Mapping[str, float] = field(default_factory=lambda: {"rms": 1.0})
    quantile: float = 0.5
    success: float = 0.95
    limits: Mapping[str, float] = field(default_factory=dict)
    delay_margin: float = 0.0

    def score(self, runs: Figures, instability: float = 0.0) -> Score:
        """Return the score of runs; instability: spectral radius above 1 within the delay margin, 0 if stable."""
        at = {name: quantile(runs[name], self.quantile) for name in FIGURES}
        share = float(np.mean(runs[SUCCESS]))
        excess = [at[name] / limit - 1 for name, limit in self.limits.items()]
        violation = sum(max(0.0, each) for each in (self.success - share, instability, *excess))
        cost = sum(weight * float(np.log(max(at[name], 1e-300))) for name, weight in self.minimise.items())
        if violation > 0 or not np.isfinite(cost):
            cost = INFEASIBLE * (1 + min(violation, WORST)) + float(np.clip(cost, -TIES, TIES))
            violation = max(violation, 1e-12)
        return Score(at, share, violation, cost)

    def refused(self) -> Score:
        """Return the score of a point without gains."""
        return Score(dict.fromkeys(FIGURES, float("inf")), 0.0, WORST, INFEASIBLE * (1 + WORST))


def _cost(key: str, given: Any) -> dict[str, float]:
    if not given:
        raise ParameterError(f"has {given!r} as '{key}'; expected some of {', '.join(FIGURES)}")
    return dict(OF_FIGURES(key, given))


MOST = 10**7  # candidates, draws
OF_FIGURES = subsection(dict.fromkeys(FIGURES, between(1e-12, 1e12)))
SIZE: Mapping[str, Reader] = dict.fromkeys(("draws", "candidates", "fresh"), between(1, MOST, whole))
GOAL: Mapping[str, Reader] = {
    "minimise": _cost,
    "limits": OF_FIGURES,
    **dict.fromkeys(("quantile", "success"), between(0, 1)),
    "delay_margin": between(0, 20),
}
"""Readers of the section `tune` of a sweep or a suite: of the fields of Goal, and of numbers of a TuningStudy."""


def quantile(values: Array, share: float) -> float:
    """Return the smallest value that at least this share of the runs keeps; infinite if that share of them is lost."""
    return float(np.quantile(values, share, method="inverted_cdf"))


@dataclass(frozen=True)
class TuningStudy(Study):
    """A search of gains for a goal over the draws of a sweep.

    start: of the search, SCENARIO or RULE. draws: runs of each candidate. candidates: number of them. fresh: runs
    of the validation. Runs are numbered: the first `draws` are those of the search, the next ones those of the
    selection, then those of the validation, so that each stage sees draws that no earlier one has seen. The seed is
    that of the sweep.
    """

    sweep: Sweep
    goal: Goal = field(default_factory=Goal)
    draws: int = 48
    candidates: int = 300
    fresh: int = 1000
    start: str = SCENARIO

    @cached_property
    def coordinates(self) -> SearchCoordinates:
        """Search space of the scenario's law."""
        return coordinates(self.sweep.scenario, self.start)

    @property
    def origin(self) -> Point:
        """Point of the start."""
        return (0.0,) * len(self.coordinates)

    @property
    def stages(self) -> tuple[Range, Range, Range]:
        """Runs of search, selection and validation, as (begin, end)."""
        search, selection = self.draws, (1 + SELECTION) * self.draws
        return (0, search), (search, selection), (selection, selection + self.fresh)

    @property
    def searched(self) -> int:
        """Largest number of runs of search and selection."""
        return self.draws * (self.candidates + (FINALISTS + 1) * SELECTION)

    def part(self, point: Point, begin: int, end: int) -> Columns:
        """Run begin .. end - 1 at a point; return number, coordinates (NaN at OF_SCENARIO) and figures by name."""
        axes = self.coordinates.axes
        at = {axis.name: np.full(end - begin, z) for axis, z in zip(axes, point or [np.nan] * len(axes), strict=True)}
        return {"run": np.arange(begin, end), **at, **self.run(point, begin, end)}

    def run(self, point: Sequence[float], begin: int, end: int) -> Figures:
        """Return the figures of the runs begin .. end - 1 with the gains at a point; NaN if no such gains exist."""
        first = self.sweep.loop
        try:
            loop = first.with_law(*self._controller(point))
        except FjrError:
            return {**dict.fromkeys(FIGURES, np.full(end - begin, np.nan)), SUCCESS: np.zeros(end - begin, bool)}
        outcomes = loop.run(self.sweep.draws(begin, end))
        return figures(outcomes, self.sweep.succeeded(outcomes))

    def score(self, point: Sequence[float], runs: Figures) -> Score:
        """Return the score of a point from its runs."""
        if np.isnan(runs["rms"]).all():
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
        numbers = {name: getattr(self, name) for name in SIZE}
        goal = {"goal": asdict(self.goal), "start": self.start}
        return json.dumps({**json.loads(self.sweep.text), **goal, **numbers}, indent=1)

    @classmethod
    def from_text(cls, text: str) -> TuningStudy:
        """Return the study with this text."""
        values: dict[str, Any] = json.loads(text)
        goal, start = Goal(**values.pop("goal")), values.pop("start")
        numbers = {name: values.pop(name) for name in SIZE}
        return cls(Sweep.from_text(json.dumps(values)), goal, **numbers, start=start)

    def build(self) -> None:
        """Compile the loop of all candidates, and tune the start of the search."""
        self.sweep.build()
        _ = self.coordinates


def with_better_start(study: TuningStudy) -> TuningStudy:
    """Return the study with the start that costs less on the draws of the search."""

    def cost(one: TuningStudy) -> float:
        return one.score(one.origin, one.run(one.origin, *one.stages[0])).cost

    if study.sweep.scenario.certified_law is not None:
        with suppress(FjrError):  # the rule may have no gains for this robot; another error comes again in the search
            return min(study, replace(study, start=RULE), key=cost)
    return study


def search(
    study: TuningStudy, figures: Callable[[Sequence[Point], Range], list[Figures]]
) -> tuple[dict[Point, Score], Point]:
    """Return the score of each candidate, the start first, and the point that is best in the selection.

    They depend only on the study. figures: returns those of each of the points over a range of runs. Raises
    ParameterError without `cma`.
    """

    def evaluate(points: Sequence[Point], runs: Range) -> list[Score]:
        return [study.score(*each) for each in zip(points, figures(points, runs), strict=True)]

    start, (first, second, _) = study.origin, study.stages
    kept = {start: evaluate([start], first)[0]}
    strategy = _strategy(len(start), study.sweep.seed)
    while len(kept) < study.candidates and not strategy.stop():
        asked = strategy.ask()
        points = [tuple(float(each) for each in point) for point in asked]
        scores = evaluate(points, first)
        strategy.tell(asked, [score.cost for score in scores])
        kept |= dict(zip(points, scores, strict=True))
    ranked = sorted((point for point in kept if point != start), key=lambda point: kept[point].cost)
    finalists = [start, *ranked[:FINALISTS]]
    return kept, finalists[int(np.argmin([score.cost for score in evaluate(finalists, second)]))]


def _strategy(dimension: int, seed: int) -> Any:
    """Return a CMAEvolutionStrategy of cma at the origin; its random numbers are its own, not NumPy's global ones."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns that it will not plot, without Matplotlib
            import cma  # loaded on use: only `fjr tune` needs it
    except ModuleNotFoundError:
        raise ParameterError(f"the package cma is not installed; expected it for tuning: {PIP} cma") from None
    random = np.random.default_rng(seed)
    options = {
        "bounds": [-WIDEST, WIDEST],
        "randn": lambda *shape: random.standard_normal(shape),
        "seed": np.nan,
        "verbose": -9,
    }
    return cma.CMAEvolutionStrategy(np.zeros(dimension), FIRST_DEVIATION, options)
