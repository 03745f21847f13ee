# SPDX-License-Identifier: Apache-2.0
"""State what gains are tuned for: a cost over drawn plants, under constraints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import ParameterError
from fjr_core.numerics.checks import Array
from fjr_core.simulation.batch.outcomes import Outcomes

MEANS = ("rms", "effort_rms", "effort_noise")
LARGEST = ("peak", "final", "effort_peak")
FIGURES = (*MEANS, *LARGEST, "power")
"""Figures of a run that a goal may use: root mean square over the joints, largest of the joints, of the whole arm."""
INFEASIBLE = 1e6
"""Cost of points that violate a constraint, at least; the cost of others is far below."""
WORST = 1e3  # violation that counts at most
TIES = 1e3  # largest part of the cost among points with the same violation
SUCCESS = "success"

Figures = dict[str, NDArray[Any]]


def figures(outcomes: Outcomes, success: NDArray[np.bool_]) -> Figures:
    """Return the figures (k,) of k runs, and `success` (k,)."""
    found: Figures = {name: np.sqrt(np.mean(np.square(getattr(outcomes, name)), axis=1)) for name in MEANS}
    found |= {name: np.max(getattr(outcomes, name), axis=1) for name in LARGEST}
    return {**found, "power": outcomes.power, SUCCESS: success}


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
    Raises ParameterError.
    """

    minimise: Mapping[str, float] = field(default_factory=lambda: {"rms": 1.0})
    quantile: float = 0.5
    success: float = 0.95
    limits: Mapping[str, float] = field(default_factory=dict)
    delay_margin: float = 0.0

    def __post_init__(self) -> None:
        for what, given in (("minimise", self.minimise), ("limits", self.limits)):
            for name, value in given.items():
                if name not in FIGURES:
                    raise ParameterError(f"'{what}' has '{name}'; expected some of {', '.join(FIGURES)}")
                if not 0 < value < np.inf:
                    raise ParameterError(f"'{what}' has {value} as '{name}'; expected a positive number")
        if not self.minimise:
            raise ParameterError(f"'minimise' is empty; expected some of {', '.join(FIGURES)}")
        for name in ("quantile", "success"):
            if not 0 <= getattr(self, name) <= 1:
                raise ParameterError(f"'{name}' is {getattr(self, name)}; expected 0 to 1")
        if not 0 <= self.delay_margin <= 20:
            raise ParameterError(f"'delay_margin' is {self.delay_margin}; expected 0 to 20 samples")

    def score(self, runs: Figures, instability: float = 0.0) -> Score:
        """Return the score of runs; instability: spectral radius above 1 within the delay margin, 0 if stable."""
        at = {name: _quantile(runs[name], self.quantile) for name in FIGURES}
        share = float(np.mean(runs[SUCCESS]))
        excess = [at[name] / limit - 1 for name, limit in self.limits.items()]
        violation = sum(max(0.0, each) for each in (self.success - share, instability, *excess))
        cost = sum(weight * float(np.log(max(at[name], 1e-300))) for name, weight in self.minimise.items())
        if violation > 0 or not np.isfinite(cost):
            cost = INFEASIBLE * (1 + min(violation, WORST)) + float(np.clip(cost, -TIES, TIES))
            violation = max(violation, 1e-12)
        return Score(at, share, violation, cost)

    def refused(self, violation: float = WORST) -> Score:
        """Return the score of a point without gains."""
        return Score({name: float("inf") for name in FIGURES}, 0.0, violation, INFEASIBLE * (1 + violation))


def joined(parts: list[Figures]) -> Figures:
    """Concatenate the figures of several parts."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _quantile(values: Array, share: float) -> float:
    """Return the smallest value that at least this share of the runs keeps; infinite for runs that are lost."""
    return float(np.quantile(values, share, method="inverted_cdf"))
