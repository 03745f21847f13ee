# SPDX-License-Identifier: Apache-2.0
"""Test whether the records contradict the prior's value of a parameter: such a parameter is known, however uncertain.

The information that uncertain initial states add by chance (`chance_information`) is estimated generously, which may
make a parameter look unknown. If the prediction with its prior's value is clearly worse, the records determine
it nevertheless.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fjr_core.numerics.checks import Array

from .bounded_step import bounded_step
from .gauss_newton import Optimum
from .multiple_shooting import Problem

WORSE = 1.1  # root mean square residual of some signal, relative to that of the optimum


def contradicted(problem: Problem, optimum: Optimum, k: int) -> bool:
    """Return whether residuals are clearly larger at the prior's mean of entry k of z, to which the others adapt."""
    return at_prior(problem, optimum, (k,)) is None


def at_prior(problem: Problem, optimum: Optimum, entries: Sequence[int]) -> tuple[Array, Array] | None:
    """Return z and initial states with some entries at their prior's mean, None if residuals are clearly larger there.

    Initial states are sought from where the normal equations move them, and from those of the optimum.
    """
    step = _adapted(problem, optimum, entries)
    moved = optimum.x0 - np.array([part.B @ step for part in optimum.projected])
    for x0 in (moved, optimum.x0):
        found = problem.evaluate(optimum.z + step, x0, optimum.noise)
        if found and np.all(problem.noise(found[1]) <= WORSE * problem.noise(optimum.compared)):
            return optimum.z + step, found[0]
    return None


def _adapted(problem: Problem, optimum: Optimum, entries: Sequence[int]) -> Array:
    """Return the step (p,) of entries to their prior's mean and of the others to the minimum of the quadratic model."""
    coordinates = problem.coordinates
    H = np.asarray(sum(part.H for part in optimum.projected)) + np.diag(coordinates.width**-2.0)
    moved = np.isin(np.arange(len(optimum.z)), entries)
    step = np.where(moved, coordinates.mean - optimum.z, 0.0)
    g = -H[np.ix_(~moved, moved)] @ step[moved]
    step[~moved] = bounded_step(H[np.ix_(~moved, ~moved)], g, optimum.z[~moved], coordinates.nonnegative[~moved])
    return step
