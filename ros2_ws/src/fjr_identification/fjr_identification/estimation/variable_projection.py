# SPDX-License-Identifier: Apache-2.0
"""Normal equations of segments without their initial states (Schur complement), steps and distance to the minimum.

G. H. Golub, V. Pereyra, SIAM Journal on Numerical Analysis 10(2), 1973.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fjr_core.numerics.checks import Array

from .bounded_step import bounded_step
from .coordinates import Coordinates
from .segments import Comparison

RIDGE = 1e-10  # of the scaled Hessian of an initial state, so that it can be factored


@dataclass(frozen=True, eq=False)
class Projected:
    """Normal equations without the initial state: H (p, p), g (p,), and its step dx = a - B dz."""

    H: Array
    g: Array
    a: Array
    B: Array


def project(compared: Comparison, size: int) -> Projected:
    """Eliminate the initial state (size,) from the normal equations of a segment."""
    scale, factor = state_factor(compared, size, 0.0)
    across, g = compared.H[:size, size:], compared.g
    B = cho_solve(factor, across / scale[:, None]) / scale[:, None]
    a = cho_solve(factor, g[:size] / scale) / scale
    return Projected(compared.H[size:, size:] - across.T @ B, g[size:] - across.T @ a, a, B)


def state_step(compared: Comparison, size: int, damping: float) -> tuple[Array, float]:
    """Return the damped step of the initial state (size,), and by how much it lowers the sum of squares."""
    scale, factor = state_factor(compared, size, damping)
    dx = cho_solve(factor, compared.g[:size] / scale) / scale
    return dx, float(dx @ compared.g[:size])


def state_factor(compared: Comparison, size: int, damping: float) -> tuple[Array, Any]:
    """Return the scale (size,) of the initial state, and the Cholesky factor of its scaled and damped Hessian."""
    scale = np.sqrt(np.diag(compared.H)[:size])
    scale = np.where(scale > 0, scale, 1.0)
    H = compared.H[:size, :size] / np.outer(scale, scale)
    return scale, cho_factor(H + (RIDGE + damping) * np.eye(size))


def parameter_step(coordinates: Coordinates, z: Array, parts: Sequence[Projected], damping: float) -> Array:
    """Return the damped step of z; one beyond twice the prior's width is shortened.

    Friction and damping do not become negative: a motor with negative friction does not stay at rest.
    """
    H, g = _normal_equations(coordinates, z, parts)
    dz = bounded_step(H, g, z, coordinates.nonnegative, damping)
    return np.asarray(dz / max(1.0, float(np.max(np.abs(dz) / coordinates.width, initial=0.0)) / 2))


def distance(coordinates: Coordinates, z: Array, parts: Sequence[Projected]) -> float:
    """Return how many standard deviations the minimum of the quadratic model is away from z."""
    H, g = _normal_equations(coordinates, z, parts)
    dz = bounded_step(H, g, z, coordinates.nonnegative)
    return float(np.sqrt(np.maximum(0.0, 2 * float(g @ dz) - float(dz @ H @ dz))))


def _normal_equations(coordinates: Coordinates, z: Array, parts: Sequence[Projected]) -> tuple[Array, Array]:
    """Return the information about z with the prior, and the gradient of log L."""
    H = np.asarray(sum(part.H for part in parts)) + np.diag(coordinates.width**-2)
    return H, np.asarray(sum(part.g for part in parts)) - (z - coordinates.mean) / coordinates.width**2
