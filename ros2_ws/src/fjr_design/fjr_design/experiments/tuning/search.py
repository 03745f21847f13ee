# SPDX-License-Identifier: Apache-2.0
"""Search gains by CMA-ES (package cma), which asks for candidates and is told their costs.

N. Hansen, A. Ostermeier, "Completely derandomized self-adaptation in evolution strategies", Evolutionary Computation 9
(2001) 159-195. Costs enter by their ranks only, so that constraints need no weights: every point that violates one
ranks behind all that do not. The search runs on a few draws, the same for all candidates. The best of them are then
compared on other draws, since the best of many on a few draws is partly luck.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fjr_core.errors import ParameterError

from .candidates import Point, Range, TuningStudy
from .goal import Score

FIRST_DEVIATION = 0.4  # of the logarithms of the factors: e^0.4 = 1.5
WIDEST = float(np.log(50.0))  # of the logarithms of the factors
FINALISTS = 6

Evaluate = Callable[[Sequence[Point], Range], list[Score]]
"""(points, range of runs) -> their scores."""


@dataclass(frozen=True)
class Candidate:
    """A point of the search with its score on the draws of the search."""

    point: Point
    score: Score


@dataclass(frozen=True)
class Found:
    """Result of a search: the start, all candidates in order, the finalists on the draws of the selection, the choice.

    The first finalist is the start.
    """

    candidates: tuple[Candidate, ...]
    finalists: tuple[Candidate, ...]
    chosen: Point

    @property
    def start(self) -> Candidate:
        """The start of the search."""
        return self.candidates[0]


def search(study: TuningStudy, evaluate: Evaluate) -> Found:
    """Search the gains of a study; the results depend only on the study. Raises ParameterError without `cma`."""
    start = study.origin
    kept = [Candidate(start, evaluate([start], study.search_runs)[0])]
    strategy = _strategy(len(start), study.sweep.seed)
    while len(kept) < study.candidates and not strategy.stop():
        asked = strategy.ask()
        points = [tuple(float(each) for each in point) for point in asked]
        scores = evaluate(points, study.search_runs)
        strategy.tell(asked, [score.cost for score in scores])
        kept += [Candidate(*each) for each in zip(points, scores, strict=True)]
    ranked = sorted(kept[1:], key=lambda one: one.score.cost)[:FINALISTS]
    points = [start, *(one.point for one in ranked)]
    scores = evaluate(points, study.selection_runs)
    finalists = tuple(Candidate(*each) for each in zip(points, scores, strict=True))
    chosen = min(finalists, key=lambda one: one.score.cost)
    return Found(tuple(kept), finalists, chosen.point)


def _strategy(dimension: int, seed: int) -> Any:
    """Return a CMAEvolutionStrategy of cma at the origin; its random numbers are its own, not NumPy's global ones."""
    try:
        import cma  # loaded on use: only `fjr tune` needs it
    except ModuleNotFoundError:
        raise ParameterError("the package cma is not installed; expected it for tuning: pip install cma") from None
    random = np.random.default_rng(seed)
    options = {
        "bounds": [-WIDEST, WIDEST],
        "randn": lambda *shape: random.standard_normal(shape),
        "seed": np.nan,
        "verbose": -9,
    }
    return cma.CMAEvolutionStrategy(np.zeros(dimension), FIRST_DEVIATION, options)
