# SPDX-License-Identifier: Apache-2.0
"""Test whether the records contradict the prior's value of a parameter: such a parameter is known, however uncertain.

The information that uncertain initial states add by chance is estimated generously (`gauss_newton`), which may make a
parameter look unknown. If the prediction with its prior's value is clearly worse, the records tell it all the same.
"""

from __future__ import annotations

import numpy as np

from ..numerics.checks import Array
from .gauss_newton import Optimum, Problem

WORSE = 1.1  # root mean square residual of some signal, relative to that of the optimum


def contradicted(problem: Problem, optimum: Optimum, k: int) -> bool:
    """Return whether residuals are clearly larger at the prior's mean of entry k of z, to which the others adapt."""
    z = optimum.z + _adapted(problem, optimum, k)
    found = problem.evaluate(z, optimum.x0, optimum.noise)
    if found is None:
        return True
    return bool(np.any(problem.noise(found[1]) > WORSE * problem.noise(optimum.compared)))


def _adapted(problem: Problem, optimum: Optimum, k: int) -> Array:
    """Return the step (p,) that moves entry k to its prior's mean and minimises the quadratic model over the others."""
    coordinates = problem.coordinates
    H = np.asarray(sum(part.H for part in optimum.projected)) + np.diag(coordinates.width**-2.0)
    step = np.zeros(len(optimum.z))
    step[k] = coordinates.mean[k] - optimum.z[k]
    others = np.arange(len(step)) != k
    scale = np.sqrt(np.diag(H)[others])
    scaled = H[np.ix_(others, others)] / np.outer(scale, scale)
    step[others] = -np.linalg.solve(scaled, H[others, k] / scale) / scale * step[k]
    return step
