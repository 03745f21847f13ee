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
_ROWS, _COLUMNS = np.tril_indices(2 * JETS, m=JETS)


def minimum_jerk(times: Array, jets: Array, free: NDArray[np.bool_]) -> Array:
    """Return the jets (k, 5, n) with the free entries (k, 5) chosen to minimise the integral of the squared jerk.

    The minimum is taken over all piecewise polynomials of degree 9 and class C^4 with knots at times (k,) [s] and the
    given jets. For given positions only, it is the quintic spline except in the first and last segment.
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded  # loaded on use: see control/vdpbc/gains.py

    h = np.diff(times)
    units = np.minimum(np.append(h, np.inf), np.insert(h, 0, np.inf))  # time unit at each knot, for scaling
    roots, chosen = _roots_of_jerk(h, units), free[:, :, None]
    factor = cholesky_banded(_normal_band(roots, free), lower=True, check_finite=False)
    y = np.where(chosen, 0.0, taylor(jets, units))
    for _ in range(NEWTON_STEPS):
        gradient = np.where(chosen, _half_gradient(roots, y), 0.0).reshape(-1, y.shape[2])
        y -= cho_solve_banded((factor, True), gradient, check_finite=False).reshape(y.shape)
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
    segments = roots.transpose(0, 2, 1) @ (roots @ np.concatenate([y[:-1], y[1:]], axis=1))
    gradient = np.zeros_like(y)
    gradient[:-1] += segments[:, :JETS]
    gradient[1:] += segments[:, JETS:]
    return gradient


def _normal_band(roots: Array, free: NDArray[np.bool_]) -> Array:
    """Return the Hessian (10, 5 k) as lower band by diagonals, with ones for fixed entries."""
    segments = roots.transpose(0, 2, 1) @ roots
    columns = np.zeros((len(free), 2 * JETS, JETS))  # per knot: its own rows, then those of the next knot
    columns[:-1] += segments[:, :, :JETS]
    columns[1:, :JETS] += segments[:, JETS:, JETS:]
    rows_free = np.concatenate([free, np.append(free[1:], free[:1] & False, axis=0)], axis=1)
    columns *= rows_free[:, :, None] & free[:, None, :]
    columns[:, _ORDERS, _ORDERS] += ~free
    band = np.zeros((2 * JETS, len(free), JETS))
    band[_ROWS - _COLUMNS, :, _COLUMNS] = columns[:, _ROWS, _COLUMNS].T
    return band.reshape(2 * JETS, -1)


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
