# SPDX-License-Identifier: Apache-2.0
"""Bound the largest eigenvalue of the normalised inertia on a box.

The largest eigenvalue is a convex function of the matrix, so that the largest one of all control matrices is a bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array
from fjr_core.numerics.intervals import UP, U, factorisable, trace_factor

from .control_matrices import ControlMatrices, NormalisedInertia, along
from .inertia_polynomial import pairs

EXCESS = 1e-9
"""Relative distance of a bound from the largest eigenvalue that was found."""
SHORTEST = 1e-6
"""Length of a range [rad, m] that is not split."""


@dataclass(frozen=True, eq=False)
class BoxBound:
    """t I - N(q) >= 0 on a box is proven for t = bound.

    direction (n,): eigenvector of the worst control matrix. worst: its index among the control matrices.
    """

    bound: float
    direction: Array
    worst: tuple[int, ...]


def box_bound(matrices: ControlMatrices, inertia: NormalisedInertia, direction: Array) -> BoxBound:
    """Return the bound of a box; direction (n,): a guess of the worst eigenvector."""
    entries = matrices.matrices
    for _ in range(2):
        worst = int(np.argmax(quadratic_form(matrices, direction)))
        largest, direction = _leading(entries[..., worst])
    size = inertia.n * float(np.max(np.abs(matrices.values)))  # no eigenvalue is larger
    left: NDArray[np.intp] = np.arange(entries.shape[-1])
    while True:
        t = largest + EXCESS * max(abs(largest), 1e-3 * size)
        left = left[~factorisable(entries[..., left], t)]
        if not len(left):
            break
        eigenvalues = np.linalg.eigvalsh(np.moveaxis(entries[..., left], -1, 0))[:, -1]
        worst = int(left[np.argmax(eigenvalues)])
        largest, direction = _leading(entries[..., worst])
    index = np.unravel_index(worst, matrices.values.shape[1:])
    return BoxBound(t + _slack(matrices, inertia, size), direction, tuple(int(i) for i in index))


def _leading(matrix: Array) -> tuple[float, Array]:
    """Return the largest eigenvalue and its eigenvector."""
    eigenvalues, vectors = np.linalg.eigh(matrix)
    return float(eigenvalues[-1]), vectors[:, -1]


def quadratic_form(matrices: ControlMatrices, direction: Array) -> Array:
    """Return v' N v (d_2, .., d_n) of all control matrices N for v = direction (n,)."""
    weights = [direction[i] * direction[j] * (1 if i == j else 2) for i, j in pairs(len(direction))]
    return np.asarray(np.tensordot(weights, matrices.values, axes=(0, 0)))


def best_split(matrices: ControlMatrices, inertia: NormalisedInertia, found: BoxBound, target: float) -> int | None:
    """Return the joint whose split reduces v' N v of the worst direction v most, as a mean over its parts.

    Values below the target count as the target. None: all ranges are too short to be split.
    """
    form = quadratic_form(matrices, found.direction)
    excess = np.full(inertia.n - 1, np.inf)
    for axis in np.flatnonzero(np.ptp(matrices.box, axis=1) > SHORTEST):
        largest = [np.max(along(part.mid, form, axis)) for part in matrices.maps(axis, inertia)]
        excess[axis] = np.mean(np.maximum(largest, target))
    return int(np.argmin(excess)) if np.isfinite(excess).any() else None


def _slack(matrices: ControlMatrices, inertia: NormalisedInertia, size: float) -> float:
    """Return the excess that covers all errors: of the factorisation, of X A X' and of the control matrices.

    The trace of a factorised matrix is at most 2 n size.
    """
    rounding = 2 * inertia.n * trace_factor(inertia.n) + 4 * U + 2 * inertia.identity_error
    return float(1.01 * UP * (rounding * size + matrices.error))
