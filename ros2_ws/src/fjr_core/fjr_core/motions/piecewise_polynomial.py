# SPDX-License-Identifier: Apache-2.0
"""Piecewise polynomials of degree 9 with given jets at the knots; of class C^4 by construction."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.checks import Array
from ..numerics.one_line import joints, span
from .bounds import ROWS, MotionBounds, motion_bounds_on
from .reference import JETS

DEGREE = 2 * JETS - 1
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


def coefficients(near: Array, far: Array) -> Array:
    """Return the polynomial (.., 10, n) in s with Taylor coefficients near (.., 5, n) at s = 0 and far at s = 1."""
    remainder = far - _BINOMIALS[:, :JETS] @ near
    return np.concatenate([near, _HIGHER @ remainder], axis=-2)


def taylor(jets: Array, h: Array) -> Array:
    """Convert jets (.., 5, n) to Taylor coefficients in s = t / h, h (..) [s]."""
    return jets * (np.asarray(h)[..., None] ** _ORDERS / _FACTORIALS)[..., None]


@dataclass(frozen=True, eq=False)
class PiecewisePolynomial:
    """Piecewise polynomial of degree 9 with jets knots (k, 5, n) at increasing times (k,) [s], k >= 2.

    It interpolates the jets of the knots exactly. Before the first time it is constant at the first position. After the
    last time it is constant at the last position, or follows the Taylor polynomial of the last knot if `continues`.
    Arguments are not checked. Each half of a segment is a polynomial about its own knot, which preserves the accuracy
    of the fourth derivative.
    """

    times: Array
    knots: Array
    continues: bool = False
    _edges: Array = field(init=False, repr=False)
    _origins: Array = field(init=False, repr=False)
    _rates: Array = field(init=False, repr=False)
    _tables: Array = field(init=False, repr=False)

    def __repr__(self) -> str:
        return f"PiecewisePolynomial({joints(self.n)}, {len(self.times) - 1} pieces, {span(self.times)})"

    def __post_init__(self) -> None:
        with np.errstate(all="ignore"):  # checked by `finite`
            self._make(np.diff(self.times))

    def _make(self, h: Array) -> None:
        halves = np.stack([h, -h], axis=1).ravel()  # from each knot forwards, then from the next knot backwards
        near = self.knots.repeat(2, axis=0)[1:-1]
        far = near.reshape(-1, 2, *near.shape[1:])[:, ::-1].reshape(near.shape)
        outer = [0.0, halves[-1] if self.continues else 0.0]
        middle = coefficients(taylor(near, halves), taylor(far, halves))
        ends = np.zeros((2, *middle.shape[1:]))
        ends[:, :JETS] = taylor(self.knots[[0, -1]], np.array(outer))
        rates = np.concatenate([[0.0], 1 / halves, [1 / halves[-1] if self.continues else 0.0]])
        c = np.concatenate([ends[:1], middle, ends[1:]])
        edges = np.stack([self.times[:-1], self.times[:-1] + h / 2], axis=1).ravel()
        object.__setattr__(self, "_edges", np.append(edges, np.nextafter(self.times[-1], inf)))
        object.__setattr__(self, "_origins", self.times.repeat(2))
        object.__setattr__(self, "_rates", rates)
        object.__setattr__(self, "_tables", _tables(c, rates))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.knots.shape[2])

    @property
    def table(self) -> tuple[Array, Array, Array, Array]:
        """Edges (m,), origins, rates (m + 1,) and coefficients (m + 1, 10, 5, n) of the jets in s = (t - origin) rate.

        Entry i = 0 .. m applies from edge i - 1 up to, but not including, edge i.
        """
        shape = (-1, DEGREE + 1, JETS, self.n)
        return self._edges, self._origins, self._rates, self._tables.reshape(shape)

    @property
    def finite(self) -> bool:
        """True if all coefficients are finite; too short segments overflow."""
        return bool(np.isfinite(self._tables).all() and np.isfinite(self._rates).all())

    def jets(self, t: ArrayLike) -> Array:
        """Return q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        t = np.asarray(t, dtype=float)
        place = np.searchsorted(self._edges, t, side="right")
        s = ((t - self._origins[place]) * self._rates[place])[..., None]
        value = self._tables[place, -1]
        for power in range(DEGREE - 1, -1, -1):
            value = value * s + self._tables[place, power]
        return value.reshape(*t.shape, JETS, self.n)

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return bounds of position, velocity and acceleration from t0 to t1 [s], t1 may be infinite."""
        t1 = min(t1, max(t0, self.times[-1]))
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
        last = len(self.times) - 2
        first, end = np.clip(np.searchsorted(self.times, [t0, t1], side="right") - 1, 0, last)
        lower, upper = (bounds[first : end + 1] for bounds in self._hulls)
        return lower.min(axis=0), upper.max(axis=0)

    def _cut(self, segments: NDArray[np.bool_] | slice, parts: int, t0: float, t1: float) -> Array:
        """Return the times between t0 and t1 [s] that divide the given segments into parts, with their ends."""
        start, length = self.times[:-1][segments, None], np.diff(self.times)[segments, None]
        times = (start + length * np.arange(parts + 1) / parts).ravel()
        return times[(times > t0) & (times < t1)]

    @cached_property
    def _hulls(self) -> tuple[Array, Array]:
        """Bounds (k - 1, 3, n) of position, velocity and acceleration per segment, from its Bezier points."""
        halves = self._tables[1:-1].reshape(-1, DEGREE + 1, JETS, self.n)[:, :, 0]
        rates = self._rates[1:-1, None]
        points = (_HALVED @ halves.swapaxes(0, 1).reshape(DEGREE + 1, -1)).reshape(-1, *halves[:, 0].shape)
        rows = [points]
        for degree in (DEGREE, DEGREE - 1):
            rows.append(2 * degree * np.diff(rows[-1], axis=0) * rates)
        lower, upper = (np.stack([f(row, axis=0) for row in rows], axis=1) for f in (np.min, np.max))
        shape = (-1, 2, ROWS, self.n)
        return lower.reshape(shape).min(axis=1), upper.reshape(shape).max(axis=1)


def _tables(c: Array, rates: Array) -> Array:
    """Return the coefficients (k, 10, 5 n) of all five jets from those of the position, c (k, 10, n) in s = rate t."""
    tables = np.zeros((len(c), DEGREE + 1, JETS, c.shape[2]))
    for order in range(JETS):
        slopes = _SLOPES[order:, order, None] * c[:, order:]
        tables[:, : DEGREE + 1 - order, order] = slopes * rates[:, None, None] ** order
    return tables.reshape(len(c), DEGREE + 1, -1)


class PolynomialReference:
    """Base of the references along `pieces`: constant before the first time and after the last."""

    pieces: PiecewisePolynomial

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.pieces.n

    @property
    def end(self) -> float:
        """Last time [s]; the reference is constant from then on."""
        return float(self.pieces.times[-1])

    def jets(self, t: ArrayLike) -> Array:
        """Return q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        return self.pieces.jets(t)

    def configurations(self, k: int) -> Array:
        """Return k configurations (k, n) [rad], equally spaced in time from the first time to the last."""
        return self.jets(np.linspace(self.pieces.times[0], self.end, k))[:, 0]

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return bounds of position, velocity and acceleration from t0 to t1 [s]."""
        return self.pieces.motion_bounds(t0, t1)

    def hull(self, t0: float, t1: float) -> tuple[Array, Array]:
        """Return conservative bounds lower, upper (3, n) of position, velocity and acceleration from t0 to t1 [s]."""
        return self.pieces.hull(t0, t1)
