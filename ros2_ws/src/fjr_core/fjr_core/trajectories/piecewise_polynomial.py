# SPDX-License-Identifier: Apache-2.0
"""Polynomials of degree 9 between knots with given jets: of class C^4 by construction."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import comb, factorial

from ..numerics.checks import Array
from .bounds import ROWS, Extremes, extremes_on
from .reference import JETS

DEGREE = 2 * JETS - 1
SAMPLES = 24  # in a piece, where extremes are looked for

_POWERS = np.arange(DEGREE + 1.0)
_ORDERS = np.arange(JETS)
_FACTORIALS = factorial(_ORDERS)
_BINOMIALS = comb(_POWERS, _ORDERS[:, None])  # of (power, order): Taylor coefficients at 1 of s^power
_HIGHER = np.rint(np.linalg.inv(_BINOMIALS[:, JETS:]))
BEZIER = comb(_POWERS[:, None], _POWERS) / comb(DEGREE, _POWERS)
_HALVED = BEZIER * 0.5**_POWERS
_SLOPES = factorial(_POWERS[:, None]) / factorial(np.maximum(_POWERS[:, None] - _ORDERS, 0))


def coefficients(near: Array, far: Array) -> Array:
    """The polynomial (.., 10, n) in s with Taylor coefficients near (.., 5, n) at s = 0 and far at s = 1."""
    rest = far - _BINOMIALS[:, :JETS] @ near
    return np.concatenate([near, _HIGHER @ rest], axis=-2)


def taylor(jets: Array, h: Array) -> Array:
    """Jets (.., 5, n) as Taylor coefficients in s = t / h, h (..)."""
    return jets * (np.asarray(h)[..., None] ** _ORDERS / _FACTORIALS)[..., None]


@dataclass(frozen=True, eq=False)
class Pieces:
    """The piecewise polynomial of degree 9 with jets knots (k, 5, n) at times (k,) [s], k >= 2, times increasing.

    It has the knots' very jets there. Before the first time it stands at the first position; after the last one
    it stands at the last position, or, where it `continues`, follows the Taylor polynomial of the last knot.
    Nothing is checked here. Each half of a piece is a polynomial about its own knot, which is what keeps the
    digits of the fourth derivative.
    """

    times: Array
    knots: Array
    continues: bool = False
    _edges: list[float] = field(init=False, repr=False)
    _origins: Array = field(init=False, repr=False)
    _rates: Array = field(init=False, repr=False)
    _tables: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        with np.errstate(all="ignore"):  # `finite` tells
            self._make(np.diff(self.times))

    def _make(self, h: Array) -> None:
        halves = np.stack([h, -h], axis=1).ravel()  # from each knot to the right, then from the next to the left
        near = self.knots.repeat(2, axis=0)[1:-1]
        far = near.reshape(-1, 2, *near.shape[1:])[:, ::-1].reshape(near.shape)
        outer = [0.0, halves[-1] if self.continues else 0.0]
        middle = coefficients(taylor(near, halves), taylor(far, halves))
        ends = np.zeros((2, *middle.shape[1:]))
        ends[:, :JETS] = taylor(self.knots[[0, -1]], np.array(outer))
        rates = np.concatenate([[0.0], 1 / halves, [1 / halves[-1] if self.continues else 0.0]])
        c = np.concatenate([ends[:1], middle, ends[1:]])
        edges = np.stack([self.times[:-1], self.times[:-1] + h / 2], axis=1).ravel()
        object.__setattr__(self, "_edges", [*edges.tolist(), float(np.nextafter(self.times[-1], inf))])
        object.__setattr__(self, "_origins", self.times.repeat(2))
        object.__setattr__(self, "_rates", rates)
        object.__setattr__(self, "_tables", _tables(c, rates))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.knots.shape[2])

    @property
    def table(self) -> tuple[Array, Array, Array, Array]:
        """Edges (m,), origins, rates (m + 1,), coefficients (m + 1, 10, 5, n) of the jets in s = (t - origin) rate.

        The i-th of them, i = 0 .. m, hold from edge i - 1 on and before edge i.
        """
        shape = (-1, DEGREE + 1, JETS, self.n)
        return np.array(self._edges), self._origins, self._rates, self._tables.reshape(shape)

    @property
    def finite(self) -> bool:
        """Whether all its numbers are finite; pieces that are too short are not."""
        return bool(np.isfinite(self._tables).all() and np.isfinite(self._rates).all())

    def jets(self, t: ArrayLike) -> Array:
        """q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        if not isinstance(t, float) and np.ndim(t):
            return self._many(np.asarray(t, dtype=float))
        now: float = t  # type: ignore[assignment]
        i = bisect_right(self._edges, now)
        s = (now - self._origins[i]) * self._rates[i]
        return np.dot(s**_POWERS, self._tables[i]).reshape(JETS, -1)

    def _many(self, t: Array) -> Array:
        place = np.searchsorted(self._edges, t, side="right")
        s = ((t - self._origins[place]) * self._rates[place])[:, None]
        value = self._tables[place, -1]
        for power in range(DEGREE - 1, -1, -1):
            value = value * s + self._tables[place, power]
        return value.reshape(len(t), JETS, self.n)

    def extremes(self, t0: float, t1: float) -> Extremes:
        """Bounds of position, velocity and acceleration from t0 to t1 [s], t1 may be infinite."""
        t1 = min(t1, max(t0, self.times[-1]))
        coarse = np.concatenate([[t0, t1], self._cut(slice(None), 2, t0, t1)])
        seen = self.jets(coarse)[:, :ROWS]
        lower, upper = self._hulls
        beyond = ((lower < seen.min(axis=0)) | (upper > seen.max(axis=0))).any(axis=(1, 2))
        reached = coarse[np.concatenate([seen.argmin(axis=0), seen.argmax(axis=0)])].ravel()
        return extremes_on(
            self.jets, np.unique(np.concatenate([[t0, t1], reached, self._cut(beyond, SAMPLES, t0, t1)]))
        )

    def hull(self, t0: float, t1: float) -> tuple[Array, Array]:
        """lower, upper (3, n) that position, velocity and acceleration do not leave between t0 and t1 [s].

        Those of the Bezier points of all half pieces of the pieces that are met: wide of these pieces' extremes by at
        most 10/9 of the largest second difference of such points (Nairn, Peters and Lutterkort, 1999), and cheap.
        """
        last = len(self.times) - 2
        first, end = np.clip(np.searchsorted(self.times, [t0, t1], side="right") - 1, 0, last)
        lower, upper = (bounds[first : end + 1] for bounds in self._hulls)
        return lower.min(axis=0), upper.max(axis=0)

    def _cut(self, pieces: NDArray[np.bool_] | slice, parts: int, t0: float, t1: float) -> Array:
        """Times within t0 and t1 [s] that cut the given pieces into parts, with their ends."""
        start, length = self.times[:-1][pieces, None], np.diff(self.times)[pieces, None]
        times = (start + length * np.arange(parts + 1) / parts).ravel()
        return times[(times > t0) & (times < t1)]

    @cached_property
    def _hulls(self) -> tuple[Array, Array]:
        """Bounds (k - 1, 3, n) of the pieces' positions, velocities and accelerations: their halves' Bezier points."""
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
    """The coefficients (k, 10, 5 n) of all five rows from those of the first, c (k, 10, n) in s = rate t."""
    tables = np.zeros((len(c), DEGREE + 1, JETS, c.shape[2]))
    for order in range(JETS):
        slopes = _SLOPES[order:, order, None] * c[:, order:]
        tables[:, : DEGREE + 1 - order, order] = slopes * rates[:, None, None] ** order
    return tables.reshape(len(c), DEGREE + 1, -1)
