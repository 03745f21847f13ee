# SPDX-License-Identifier: Apache-2.0
"""The most likely parameters by simulation, with all of them and without those that the records do not determine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from fjr_core.numerics.checks import Array

from .chance_information import assumed_information, chance_information
from .estimation_problem import Estimation
from .gauss_newton import Optimum, optimise, refine
from .initial_guess import FilteredMotion
from .multiple_shooting import Problem
from .prior_test import at_prior, contradicted
from .verdict import not_identifiable


@dataclass(frozen=True, eq=False)
class Simulation:
    """Optimum with all parameters, what it does not determine, and the optimum without these; the problem of each.

    chance (p, p): information about all parameters that is due to noise and to the prior of the initial states.
    """

    problem: Problem
    whole: Optimum
    chance: Array
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
    progress("intervals", 0.0)
    chance = chance_information(problem, whole) + assumed_information(problem, whole)
    unknown = not_identifiable(whole.projected, chance, setup.coordinates.width)
    fixed = tuple(k for k in unknown if not contradicted(problem, whole, k))
    if not fixed:
        return Simulation(problem, whole, chance, fixed, (problem, whole))
    fewer = setup.problem(setup.coordinates.without(fixed), start, motions)
    kept = [k for k in range(len(z)) if k not in fixed]
    z, x0 = at_prior(problem, whole, fixed) or (whole.z, whole.x0)
    again = refine(fewer, z[kept], x0, whole.noise, lambda share: progress("prediction error again", share))
    return Simulation(problem, whole, chance, fixed, (fewer, again))
