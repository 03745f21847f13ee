# SPDX-License-Identifier: Apache-2.0
"""Piecewise polynomials of degree 9 with given jets at the knots, of class C^4 by construction.

Derivatives at the knots that are free minimise the jerk, and are reduced where a segment would overshoot.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.checks import Array, freeze
from ..numerics.one_line import joints, span
from .reference import JETS, ROWS, MotionBounds, motion_bounds_on

DEGREE = 2 * JETS - 1  # of a segment, which the jets at both ends determine
SAMPLES = 24  # per segment, for the search of extrema

comb = np.vectorize(lambda n, k: math.comb(int(n), int(k)), otypes=[float])
factorial = np.vectorize(lambda n: math.factorial(int(n)), otypes=[float])

_POWERS = np.arange(DEGREE + 1.0)
_ORDERS = np.arange(JETS)
_FACTORIALS = factorial(_ORDERS)
_BINOMIALS = comb(_POWERS, _ORDERS[:, None])  # of (power, order): Taylor coefficients at 1 of s^power
_HIGHER = np.rint(np.linalg.inv(_BINOMIALS[:, JETS:]))
BEZIER = comb(_POWERS[:, None], _POWERS) / comb(DEGREE, _POWERS)
_HALVED = BEZIER * 0.5**_POWERS
_SLOPES = factorial(_POWERS[:, None]) / factorial(np.maximum(_POWERS[:, None] - _ORDERS, 0))
JERK = 3  # order of the derivative whose mean square is least
NEWTON_STEPS = 2
"""The second step corrects rounding errors of the first: the condition number is at most 1e8 for segment lengths that
differ by a factor of a million."""
TURNING, MONOTONE = 1 / 4, 1 / 100
"""Admissible overshoot beyond the range of the two adjacent points, relative to the range of the nearest four points:
at a turning point, and for monotone points."""


def coefficients(near: Array, far: Array) -> Array:
    """Return the polynomial (.., 10, n) in s with Taylor coefficients near (.., 5, n) at s = 0 and far at s = 1."""
    remainder = far - _BINOMIALS[:, :JETS] @ near
    return np.concatenate([near, _HIGHER @ remainder], axis=-2)


def taylor(jets: Array, h: Array) -> Array:
    """Convert jets (.., 5, n) to Taylor coefficients in s = t / h, h (..) [s]."""
    return jets * (np.asarray(h)[..., None] ** _ORDERS / _FACTORIALS)[..., None]


class PolynomialReference:
    """Base of references along polynomials of degree 9 with jets knot_jets (k, 5, n) at knots knot_times (k,) [s].

    The times increase, k >= 2. The jets of the knots are interpolated exactly. Before the first time the reference is
    constant at the first position. After the last time it is constant at the last position, or follows the Taylor
    polynomial of the last knot if `continues`. With a `period` [s] it repeats itself from t = 0 on, and bounds are
    those of all times.
    Each half of a segment is a polynomial about its own knot, which preserves the accuracy of the fourth derivative.
    """

    knot_times: Array
    knot_jets: Array
    continues: bool = False
    period: float = 0.0

    def set_knots(self, times: Array, jets: Array) -> None:
        """Set times and jets of the knots, without checks."""
        freeze(self, "knot_times", times)
        freeze(self, "knot_jets", jets)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.knot_jets.shape[2])

    @property
    def end(self) -> float:
        """Time [s] from which on the reference is constant; infinite if it continues or repeats itself."""
        return inf if self.continues or self.period else float(self.knot_times[-1])

    @cached_property
    def table(self) -> tuple[Array, Array, Array, Array]:
        """Edges (m,), origins, rates (m + 1,) and coefficients (m + 1, 10, 5, n) of the jets in s = (t - origin) rate.

        Entry i = 0 .. m applies from edge i - 1 up to, but not including, edge i.
        """
        h = np.diff(self.knot_times)
        halves = np.stack([h, -h], axis=1).ravel()  # from each knot forwards, then from the next knot backwards
        near = self.knot_jets.repeat(2, axis=0)[1:-1]
        far = near.reshape(-1, 2, *near.shape[1:])[:, ::-1].reshape(near.shape)
        with np.errstate(all="ignore"):  # checked by `finite`
            outer = [0.0, halves[-1] if self.continues else 0.0]
            middle = coefficients(taylor(near, halves), taylor(far, halves))
            ends = np.zeros((2, *middle.shape[1:]))
            ends[:, :JETS] = taylor(self.knot_jets[[0, -1]], np.array(outer))
            rates = np.concatenate([[0.0], 1 / halves, [1 / halves[-1] if self.continues else 0.0]])
            c = np.concatenate([ends[:1], middle, ends[1:]])  # (k, 10, n), of the position in s = rate t
            tables = np.zeros((len(c), DEGREE + 1, JETS, self.n))
            for order in range(JETS):
                slopes = _SLOPES[order:, order, None] * c[:, order:]
                tables[:, : DEGREE + 1 - order, order] = slopes * rates[:, None, None] ** order
        edges = np.stack([self.knot_times[:-1], self.knot_times[:-1] + h / 2], axis=1).ravel()
        return np.append(edges, np.nextafter(self.knot_times[-1], inf)), self.knot_times.repeat(2), rates, tables

    @property
    def finite(self) -> bool:
        """True if all coefficients are finite; too short segments overflow."""
        _, _, rates, tables = self.table
        return bool(np.isfinite(tables).all() and np.isfinite(rates).all())

    def jets(self, t: ArrayLike) -> Array:
        """Return q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        t, (edges, origins, rates, tables) = np.asarray(t, dtype=float), self.table
        t = np.maximum(t, 0.0) % self.period if self.period else t
        place = np.searchsorted(edges, t, side="right")
        s = ((t - origins[place]) * rates[place])[..., None, None]
        value = tables[place, -1]
        for power in range(DEGREE - 1, -1, -1):
            value = value * s + tables[place, power]
        return np.asarray(value)

    def configurations(self, k: int) -> Array:
        """Return k configurations (k, n) [rad], equally spaced in time from the first knot to the last."""
        return self.jets(np.linspace(self.knot_times[0], self.knot_times[-1], k))[:, 0]

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return bounds of position, velocity and acceleration from t0 to t1 [s]; of a period if the motion repeats."""
        t0, t1 = (0.0, self.period) if self.period else (t0, min(t1, max(t0, self.knot_times[-1])))
        coarse = np.concatenate([[t0, t1], self._cut(slice(None), 2, t0, t1)])
        seen = self.jets(coarse)[:, :ROWS]
        lower, upper = self._hulls
        beyond = ((lower < seen.min(axis=0)) | (upper > seen.max(axis=0))).any(axis=(1, 2))
        reached = coarse[np.concatenate([seen.argmin(axis=0), seen.argmax(axis=0)])].ravel()
        return motion_bounds_on(
            self.jets, np.unique(np.concatenate([[t0, t1], reached, self._cut(beyond, SAMPLES, t0, t1)]))
        )

    def hull(self, t0: float, t1: float) -> tuple[Array, Array]:
        """Return conservative bounds lower, upper (3, n) of position, velocity and acceleration from t0 to t1 [s].

        The bounds are those of the Bezier points of all half segments involved. They exceed the extrema by at most 10/9
        of the largest second difference of these points (Nairn, Peters and Lutterkort, 1999).
        """
        t0, t1, last = *((0.0, self.period) if self.period else (t0, t1)), len(self.knot_times) - 2
        first, end = np.clip(np.searchsorted(self.knot_times, [t0, t1], side="right") - 1, 0, last)
        lower, upper = (bounds[first : end + 1] for bounds in self._hulls)
        return lower.min(axis=0), upper.max(axis=0)

    def _cut(self, segments: NDArray[np.bool_] | slice, parts: int, t0: float, t1: float) -> Array:
        """Return the times between t0 and t1 [s] that divide the given segments into parts, with their ends."""
        start, length = self.knot_times[:-1][segments, None], np.diff(self.knot_times)[segments, None]
        times = (start + length * np.arange(parts + 1) / parts).ravel()
        return times[(times > t0) & (times < t1)]

    @cached_property
    def _hulls(self) -> tuple[Array, Array]:
        """Bounds (k - 1, 3, n) of position, velocity and acceleration per segment, from its Bezier points."""
        _, _, rates, tables = self.table
        halves, rates = tables[1:-1, :, 0], rates[1:-1, None]
        points = (_HALVED @ halves.swapaxes(0, 1).reshape(DEGREE + 1, -1)).reshape(-1, *halves[:, 0].shape)
        rows = [points]
        for degree in (DEGREE, DEGREE - 1):
            rows.append(2 * degree * np.diff(rows[-1], axis=0) * rates)
        lower, upper = (np.stack([f(row, axis=0) for row in rows], axis=1) for f in (np.min, np.max))
        shape = (-1, 2, ROWS, self.n)
        return lower.reshape(shape).min(axis=1), upper.reshape(shape).max(axis=1)


@dataclass(frozen=True, eq=False)
class PiecewisePolynomial(PolynomialReference):
    """Reference along polynomials with these knots; arguments are not checked."""

    knot_times: Array
    knot_jets: Array
    continues: bool = False
    period: float = 0.0

    def __repr__(self) -> str:
        return f"PiecewisePolynomial({joints(self.n)}, {len(self.knot_times) - 1} pieces, {span(self.knot_times)})"


def _jerk_root() -> Array:
    """Return W (7, 10) with |W (near, far)|^2 the integral of the squared third derivative over s in (0, 1)."""
    nodes, weights = np.polynomial.legendre.leggauss(DEGREE - JERK + 1)
    powers = np.arange(JERK, DEGREE + 1)
    slopes = factorial(powers) / factorial(powers - JERK) * ((nodes[:, None] + 1) / 2) ** (powers - JERK)
    ends = np.eye(2 * JETS)
    return np.asarray(np.sqrt(weights / 2)[:, None] * slopes @ coefficients(ends[:JETS], ends[JETS:])[JERK:])


_JERK_ROOT = _jerk_root()


def minimum_jerk(times: Array, jets: Array, free: NDArray[np.bool_]) -> Array:
    """Return the jets (k, 5, n) with the free entries (k, 5) chosen to minimise the integral of the squared jerk.

    The minimum is taken over all piecewise polynomials of degree 9 and class C^4 with knots at times (k,) [s] and the
    given jets. For given positions only, it is the quintic spline except in the first and last segment.
    """
    h = np.diff(times)
    units = np.minimum(np.append(h, np.inf), np.insert(h, 0, np.inf))  # time unit at each knot, for scaling
    weights, chosen = (h / h.max()) ** -(JERK - 0.5), free[:, :, None]
    # W of the near and the far knot of each segment: the sum of |W y|^2 is the integral, up to a factor, if y are the
    # Taylor coefficients of the knots in `units`.
    near, far = (
        weights[:, None, None] * root * (h / unit)[:, None, None] ** _ORDERS
        for root, unit in ((_JERK_ROOT[:, :JETS], units[:-1]), (_JERK_ROOT[:, JETS:], units[1:]))
    )
    diagonal = _of_knots(_transposed(near) @ near, _transposed(far) @ far) * (chosen & free[:, None, :])
    diagonal[:, _ORDERS, _ORDERS] += ~free  # the identity for given entries
    solve = _block_solver(diagonal, _transposed(far) @ near * (chosen[1:] & free[:-1, None, :]))
    y = np.where(chosen, 0.0, taylor(jets, units))
    for _ in range(NEWTON_STEPS):
        jerk = near @ y[:-1] + far @ y[1:]
        y -= solve(np.where(chosen, _of_knots(_transposed(near) @ jerk, _transposed(far) @ jerk), 0.0))
    return np.where(chosen, y / taylor(np.ones_like(jets), units), jets)


def _of_knots(near: Array, far: Array) -> Array:
    """Return the sums (k, ..) at the knots of what each of k - 1 segments adds to its near and its far knot."""
    none = np.zeros_like(near[:1])
    return np.concatenate([near, none]) + np.concatenate([none, far])


def _block_solver(diagonal: Array, lower: Array) -> Callable[[Array], Array]:
    """Return the function b (k, m, n) -> x that solves a positive definite block-tridiagonal system, in NumPy alone.

    diagonal (k, m, m), lower (k - 1, m, m): blocks of the matrix. Cyclic reduction eliminates every other block, of
    Cholesky factor L, from its neighbours `left` and `right`, here times L^-1; half as many blocks are left.
    Raise LinAlgError if the matrix is not positive definite to rounding.
    """
    if not len(diagonal):
        return lambda b: b
    inverse, odd = np.linalg.inv(np.linalg.cholesky(diagonal[::2])), len(diagonal) // 2
    left, right = inverse[1:] @ lower[1::2], inverse[:odd] @ _transposed(lower[::2])
    others = diagonal[1::2] - _transposed(right) @ right
    others[: len(left)] -= _transposed(left) @ left
    solve_others = _block_solver(others, -_transposed(right[1:]) @ left[: odd - 1])

    def solve(b: Array) -> Array:
        y, c = inverse @ b[::2], b[1::2].copy()
        c -= _transposed(right) @ y[:odd]
        c[: len(left)] -= _transposed(left) @ y[1:]
        x = solve_others(c)
        y[:odd] -= right @ x
        y[1:] -= left @ x[: len(left)]
        solution = np.empty_like(b)
        solution[::2], solution[1::2] = _transposed(inverse) @ y, x
        return solution

    return solve


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
