# SPDX-License-Identifier: Apache-2.0
"""Information about z that the normal equations contain although the records do not determine it. It has two causes.

Initial states fit noise: a spring at rest seems to swing, at a frequency that seems to reveal its stiffness. And
initial states have a prior: without a motor encoder the offset of a spring only shifts the motor, away from this prior.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from fjr_core.numerics.checks import Array

from .gauss_newton import Optimum
from .multiple_shooting import Problem
from .variable_projection import RIDGE, project, state_factor

LEAST_DRAWS = 24  # of all segments together
CAUTION = 4.0  # factor on both: growth is estimated from few draws, the prior's share to first order


def chance_information(problem: Problem, optimum: Optimum) -> Array:
    """Return CAUTION times the growth of the information (p, p) under disturbances of the initial states.

    Disturbances have the covariance of the initial states and come with both signs, so that what is linear in them
    cancels. No segment loses more than it contains, before CAUTION.
    """
    segments, size = optimum.x0.shape
    draws = max(1, LEAST_DRAWS // segments)
    normals = np.random.default_rng(0).standard_normal((segments, draws, size))
    return CAUTION * np.asarray(sum(problem.of_each(lambda k: _of_segment(problem, optimum, k, normals[k]))))


def assumed_information(problem: Problem, optimum: Optimum) -> Array:
    """Return CAUTION times the information (p, p) that is due to the prior of the initial states and to their ridge.

    Initial states follow z by -B dz, away from their prior: sum_s B' diag(1 / width^2 + ridge) B.
    """
    size, found = optimum.x0.shape[1], []
    for compared, part in zip(optimum.compared, optimum.projected, strict=True):
        weight = problem.state_width**-2 + RIDGE * np.diag(compared.H)[:size]
        found.append(part.B.T @ (weight[:, None] * part.B))
    return CAUTION * np.asarray(sum(found))


def _of_segment(problem: Problem, optimum: Optimum, k: int, normals: Array) -> Array:
    x, size, told = optimum.x0[k], normals.shape[1], optimum.projected[k].H
    scale, (factor, lower) = state_factor(optimum.compared[k], size, 0.0)
    growth = np.zeros_like(told)
    for normal in normals:
        dx = solve_triangular(factor, normal, trans=1 if lower else 0, lower=lower) / scale
        pair = [problem.compare(k, optimum.z, x + sign * dx, optimum.noise) for sign in (1, -1)]
        complete = [project(each, size).H for each in pair if each is not None]
        if len(complete) == len(pair):
            growth += (sum(complete) / 2 - told) / len(normals)
    told, grown = np.maximum(np.diag(told), 0.0), np.diag(growth)
    limit = np.sqrt(np.where(grown > told, told / np.where(grown > 0, grown, 1.0), 1.0))
    return np.asarray(growth * np.outer(limit, limit))
