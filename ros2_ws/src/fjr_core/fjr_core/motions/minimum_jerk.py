# SPDX-License-Identifier: Apache-2.0
"""Choose the free derivatives at the knots of a trajectory: minimum jerk, and without overshoot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..numerics.checks import Array
from .piecewise_polynomial import BEZIER, DEGREE, coefficients, factorial, taylor
from .reference import JETS

JERK = 3
NEWTON_STEPS = 2
"""The second step corrects rounding errors of the first: the condition number is at most 1e8 for segment lengths that
differ by a factor of a million."""
TURNING, MONOTONE = 1 / 4, 1 / 100
"""Admissible overshoot beyond the range of the two adjacent points, relative to the range of the nearest four points:
at a turning point, and for monotone points."""


def _jerk_root() -> Array:
    """Return W (7, 10) with |W (near, far)|^2 the integral of the squared third derivative over s in (0, 1)."""
    nodes, weights = np.polynomial.legendre.leggauss(DEGREE - JERK + 1)
    powers = np.arange(JERK, DEGREE + 1)
    slopes = factorial(powers) / factorial(powers - JERK) * ((nodes[:, None] + 1) / 2) ** (powers - JERK)
    ends = np.eye(2 * JETS)
    return np.asarray(np.sqrt(weights / 2)[:, None] * slopes @ coefficients(ends[:JETS], ends[JETS:])[JERK:])


_JERK_ROOT = _jerk_root()
_ORDERS = np.arange(JETS)


def minimum_jerk(times: Array, jets: Array, free: NDArray[np.bool_]) -> Array:
    """Return the jets (k, 5, n) with the free entries (k, 5) chosen to minimise the integral of the squared jerk.

    The minimum is taken over all piecewise polynomials of degree 9 and class C^4 with knots at times (k,) [s] and the
    given jets. For given positions only, it is the quintic spline except in the first and last segment.
    """
    h = np.diff(times)
    units = np.minimum(np.append(h, np.inf), np.insert(h, 0, np.inf))  # time unit at each knot, for scaling
    roots, chosen = _roots_of_jerk(h, units), free[:, :, None]
    levels = _reduced(*_normal_blocks(roots, free))
    y = np.where(chosen, 0.0, taylor(jets, units))
    for _ in range(NEWTON_STEPS):
        y -= _solved(levels, np.where(chosen, _half_gradient(roots, y), 0.0))
    return np.where(chosen, y / taylor(np.ones_like(jets), units), jets)


def _roots_of_jerk(h: Array, units: Array) -> Array:
    """Return W (k - 1, 7, 10): |W y|^2 is the integral of the squared jerk of a segment, up to a common factor.

    y (10, n): Taylor coefficients of the two knots of the segment in `units`.
    """
    knots = np.arange(len(h))[:, None] + [0, 1]
    scales = (h[:, None, None] / units[knots][:, :, None]) ** np.arange(JETS)
    weights = (h / h.max())[:, None, None] ** -(JERK - 0.5)
    return np.asarray(weights * _JERK_ROOT * scales.reshape(len(h), 1, -1))


def _half_gradient(roots: Array, y: Array) -> Array:
    """Return half the gradient (k, 5, n) of the squared jerk norm at the Taylor coefficients y (k, 5, n)."""
    segments = _transposed(roots) @ (roots @ np.concatenate([y[:-1], y[1:]], axis=1))
    gradient = np.zeros_like(y)
    gradient[:-1] += segments[:, :JETS]
    gradient[1:] += segments[:, JETS:]
    return gradient


def _normal_blocks(roots: Array, free: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the diagonal (k, 5, 5) and lower (k - 1, 5, 5) blocks of the Hessian, the identity for fixed entries."""
    segments = _transposed(roots) @ roots
    diagonal = np.zeros((len(free), JETS, JETS))
    diagonal[:-1] += segments[:, :JETS, :JETS]
    diagonal[1:] += segments[:, JETS:, JETS:]
    diagonal *= free[:, :, None] & free[:, None, :]
    diagonal[:, _ORDERS, _ORDERS] += ~free
    return diagonal, segments[:, JETS:, :JETS] * (free[1:, :, None] & free[:-1, None, :])


def _reduced(diagonal: Array, lower: Array) -> list[tuple[Array, Array, Array]]:
    """Factorise a positive definite block-tridiagonal matrix by cyclic reduction: NumPy alone, no loop over the blocks.

    Each level eliminates every other block, of Cholesky factor L: L^-1, and L^-1 times the blocks left and right of it.
    Raise LinAlgError if the matrix is not positive definite to rounding.
    """
    levels = []
    while len(diagonal):
        inverse, odd = np.linalg.inv(np.linalg.cholesky(diagonal[::2])), len(diagonal) // 2
        left, right = np.zeros_like(inverse), np.zeros_like(inverse)
        left[1:] = inverse[1:] @ lower[1::2]
        right[:odd] = inverse[:odd] @ _transposed(lower[::2])
        levels.append((inverse, left, right))
        diagonal = diagonal[1::2] - _transposed(right[:odd]) @ right[:odd]
        diagonal[: len(inverse) - 1] -= _transposed(left[1:]) @ left[1:]
        lower = -_transposed(right[1:odd]) @ left[1:odd]
    return levels


def _solved(levels: list[tuple[Array, Array, Array]], b: Array) -> Array:
    """Return the solution (k, 5, n) of the factorised system for b (k, 5, n)."""
    eliminated = []
    for inverse, left, right in levels:
        y, odd = inverse @ b[::2], len(b) // 2
        eliminated.append(y)
        b = b[1::2] - _transposed(right[:odd]) @ y[:odd]
        b[: len(y) - 1] -= _transposed(left[1:]) @ y[1:]
    x = b
    for (inverse, left, right), y in zip(reversed(levels), reversed(eliminated), strict=True):
        y[: len(x)] -= right[: len(x)] @ x
        y[1:] -= left[1:] @ x[: len(y) - 1]
        both = np.empty((len(x) + len(y), *y.shape[1:]))
        both[::2], both[1::2] = _transposed(inverse) @ y, x
        x = both
    return x


def _transposed(blocks: Array) -> Array:
    return blocks.transpose(0, 2, 1)


def without_overshoot(times: Array, jets: Array, free: NDArray[np.bool_]) -> Array:
    """Return the jets (k, 5, n) with the free entries (k, 5) reduced, knot by knot, until no segment overshoots.

    A segment lies in the convex hull of its ten Bezier points. The five next to a knot depend on this knot only and are
    kept within the range of the two end points, widened by TURNING or MONOTONE. Bezier points that leave the range
    because of given derivatives are ignored.
    """
    lower, upper = _ranges(jets[:, 0])
    h = np.diff(times)
    share = np.ones((len(times), jets.shape[2]))
    for knots, signed in ((slice(0, -1), h), (slice(1, None), -h)):
        given = BEZIER[:JETS, :JETS] @ taylor(np.where(free[knots, :, None], 0.0, jets[knots]), signed)
        chosen = BEZIER[:JETS, :JETS] @ taylor(np.where(free[knots, :, None], jets[knots], 0.0), signed)
        room = np.where(chosen > 0, upper[:, None] - given, given - lower[:, None])
        limit = np.divide(room, np.abs(chosen), out=np.ones_like(room), where=(chosen != 0) & (room >= 0))
        share[knots] = np.minimum(share[knots], limit.min(axis=1))
    return np.where(free[:, :, None], share[:, None] * jets, jets)


def _ranges(q: Array) -> tuple[Array, Array]:
    """Return lower, upper (k - 1, n) [rad]: admissible ranges of the segments between the points q (k, n)."""
    padded = np.concatenate([q[:1], q, q[-1:]])
    four = np.stack([padded[:-3], padded[1:-2], padded[2:-1], padded[3:]])
    steps = np.diff(four, axis=0)
    turns = (steps.min(axis=0) < 0) & (steps.max(axis=0) > 0)
    margin = np.where(turns, TURNING, MONOTONE) * np.ptp(four, axis=0)
    return four[1:3].min(axis=0) - margin, four[1:3].max(axis=0) + margin
