# SPDX-License-Identifier: Apache-2.0
"""The derivatives at the points of a trajectory that nobody gave: of least jerk, and without overshoot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.special import factorial

from ..numerics.checks import Array
from .piecewise_polynomial import BEZIER, DEGREE, coefficients, taylor
from .reference import JETS

JERK = 3
NEWTON_STEPS = 2
"""The second one mends what rounding has left of the first: the matrix has a condition of at most 1e8 for pieces that
differ by a factor of a million."""
TURNING, MONOTONE = 1 / 4, 1 / 100
"""How far a curve may leave the range of the two points beside it, in parts of the range of the nearest four: where
the points turn, and where they rise or fall throughout."""


def _jerk_root() -> Array:
    """W (7, 10) with |W (near, far)|^2 the integral of the squared third derivative over s in (0, 1)."""
    nodes, weights = np.polynomial.legendre.leggauss(DEGREE - JERK + 1)
    powers = np.arange(JERK, DEGREE + 1)
    slopes = factorial(powers) / factorial(powers - JERK) * ((nodes[:, None] + 1) / 2) ** (powers - JERK)
    ends = np.eye(2 * JETS)
    return np.asarray(np.sqrt(weights / 2)[:, None] * slopes @ coefficients(ends[:JETS], ends[JETS:])[JERK:])


_JERK_ROOT = _jerk_root()
_ORDERS = np.arange(JETS)
_ROWS, _COLUMNS = np.tril_indices(2 * JETS, m=JETS)


def least_jerk(times: Array, jets: Array, free: NDArray[np.bool_]) -> Array:
    """The jets (k, 5, n) with those marked free (k, 5) chosen so that the integral of the squared jerk is least.

    This is over all piecewise polynomials of degree 9 and class C^4 with knots at times (k,) [s] that have the
    other jets; where positions alone are given it is the quintic spline but for its first and last piece.
    """
    h = np.diff(times)
    units = np.minimum(np.append(h, np.inf), np.insert(h, 0, np.inf))  # of time at each knot, for equal scales
    roots, chosen = _roots_of_jerk(h, units), free[:, :, None]
    factor = cholesky_banded(_normal_band(roots, free), lower=True, check_finite=False)
    y = np.where(chosen, 0.0, taylor(jets, units))
    for _ in range(NEWTON_STEPS):
        slope = np.where(chosen, _slope(roots, y), 0.0).reshape(-1, y.shape[2])
        y -= cho_solve_banded((factor, True), slope, check_finite=False).reshape(y.shape)
    return np.where(chosen, y / taylor(np.ones_like(jets), units), jets)


def _roots_of_jerk(h: Array, units: Array) -> Array:
    """Matrices W (k - 1, 7, 10): |W y|^2, y the Taylor coefficients (10, n) of a piece's two knots in `units`, is the
    integral of its squared jerk, but for a factor that all pieces have in common.
    """
    knots = np.arange(len(h))[:, None] + [0, 1]
    scales = (h[:, None, None] / units[knots][:, :, None]) ** np.arange(JETS)
    weights = (h / h.max())[:, None, None] ** -(JERK - 0.5)
    return np.asarray(weights * _JERK_ROOT * scales.reshape(len(h), 1, -1))


def _slope(roots: Array, y: Array) -> Array:
    """Half the gradient (k, 5, n) of the jerk's square norm at the Taylor coefficients y (k, 5, n)."""
    pieces = roots.transpose(0, 2, 1) @ (roots @ np.concatenate([y[:-1], y[1:]], axis=1))
    slope = np.zeros_like(y)
    slope[:-1] += pieces[:, :JETS]
    slope[1:] += pieces[:, JETS:]
    return slope


def _normal_band(roots: Array, free: NDArray[np.bool_]) -> Array:
    """The matrix of _slope (10, 5 k), lower band by diagonals, with ones for what is not free."""
    pieces = roots.transpose(0, 2, 1) @ roots
    columns = np.zeros((len(free), 2 * JETS, JETS))  # of each knot: its own rows, then those of the next one
    columns[:-1] += pieces[:, :, :JETS]
    columns[1:, :JETS] += pieces[:, JETS:, JETS:]
    rows_free = np.concatenate([free, np.append(free[1:], free[:1] & False, axis=0)], axis=1)
    columns *= rows_free[:, :, None] & free[:, None, :]
    columns[:, _ORDERS, _ORDERS] += ~free
    band = np.zeros((2 * JETS, len(free), JETS))
    band[_ROWS - _COLUMNS, :, _COLUMNS] = columns[:, _ROWS, _COLUMNS].T
    return band.reshape(2 * JETS, -1)


def without_overshoot(times: Array, jets: Array, free: NDArray[np.bool_]) -> Array:
    """The jets (k, 5, n) with those marked free (k, 5) made smaller, knot by knot, until no piece overshoots.

    A piece lies in the hull of its ten Bezier points; the five next to a knot depend on that knot alone and are kept
    within the range of the piece's two points, widened as TURNING and MONOTONE say. Where given derivatives
    leave it, those points are not looked at.
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
    """lower, upper (k - 1, n): where the pieces between the points q (k, n) may go."""
    padded = np.concatenate([q[:1], q, q[-1:]])
    four = np.stack([padded[:-3], padded[1:-2], padded[2:-1], padded[3:]])
    steps = np.diff(four, axis=0)
    turns = (steps.min(axis=0) < 0) & (steps.max(axis=0) > 0)
    margin = np.where(turns, TURNING, MONOTONE) * np.ptp(four, axis=0)
    return four[1:3].min(axis=0) - margin, four[1:3].max(axis=0) + margin
