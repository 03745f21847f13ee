# SPDX-License-Identifier: Apache-2.0
"""The most likely parameters by simulation, with all of them and without those that the records do not tell."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ..numerics.checks import Array
from .estimation_problem import Estimation
from .gauss_newton import Optimum, Problem, optimise, refine
from .initial_guess import FilteredMotion
from .prior_test import contradicted
from .verdict import not_identifiable


@dataclass(frozen=True, eq=False)
class Simulation:
    """Optimum with all parameters, what it does not tell, and the optimum without these; the problem of each."""

    problem: Problem
    whole: Optimum
    fixed: tuple[int, ...]
    last: tuple[Problem, Optimum]

    @property
    def optimum(self) -> Optimum:
        """Return the optimum without the parameters that are not identifiable."""
        return self.last[1]

    @property
    def z(self) -> Array:
        """Return z (p,) with the prior's mean of what is not identifiable."""
        z = self.problem.coordinates.mean.copy()
        z[[k for k in range(len(z)) if k not in self.fixed]] = self.optimum.z
        return z


def simulated_fit(
    setup: Estimation,
    motions: Sequence[FilteredMotion],
    start: Mapping[str, Array],
    progress: Callable[[str, float], None],
) -> Simulation:
    """Return the most likely parameters, and those without the ones that are not identifiable."""
    problem = setup.problem(setup.coordinates, start, motions)
    z = setup.coordinates.of_values(start)
    whole = optimise(problem, z, problem.filtered, lambda share: progress("prediction error", share))
    unknown = not_identifiable(whole.projected, whole.chance, setup.coordinates.width)
    fixed = tuple(k for k in unknown if not contradicted(problem, whole, k))
    if not fixed:
        return Simulation(problem, whole, fixed, (problem, whole))
    fewer = setup.problem(setup.coordinates.without(fixed), start, motions)
    kept = [k for k in range(len(z)) if k not in fixed]
    again = refine(fewer, whole.z[kept], whole.x0, whole.noise, lambda share: progress("prediction error again", share))
    return Simulation(problem, whole, fixed, (fewer, again))
