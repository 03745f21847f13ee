# SPDX-License-Identifier: Apache-2.0
"""Midpoint-radius interval arithmetic on arrays, with rounding accounted for in the radius.

A real number x is enclosed if |x - mid| <= rad. With u = 2^-53, an operation of IEEE double precision in any rounding
mode to nearest satisfies |fl(a o b) - a o b| <= u |fl(a o b)| + 2^-1074. Every operation adds this error to the radius,
and enlarges the radius by a factor that covers its own rounding. S. M. Rump, Verification methods: rigorous results
using floating-point arithmetic, Acta Numerica 19 (2010), sec. 9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import Array

U = 2.0**-53
"""Unit roundoff of double precision."""
TINY = 2.0**-1022
"""More than the error of any operation that underflows, times 2^50."""
UP = 1 + 2.0**-48
"""Factor that covers 15 roundings in the computation of a radius."""
LIBRARY = 8 * U
"""Bound of the error of sin and cos: 4 units in the last place of a number up to 1."""


@dataclass(frozen=True, eq=False)
class Interval:
    """An array of intervals: midpoints mid and radii rad, of one shape."""

    mid: Array
    rad: Array

    @staticmethod
    def exact(value: ArrayLike) -> Interval:
        """Return the numbers themselves, with radius zero."""
        mid = np.asarray(value, dtype=float)
        return Interval(mid, np.zeros_like(mid))

    @property
    def magnitude(self) -> Array:
        """Upper bound of the absolute values."""
        return np.asarray(UP * (np.abs(self.mid) + self.rad))

    def __getitem__(self, at: Any) -> Interval:
        return Interval(self.mid[at], self.rad[at])

    def __neg__(self) -> Interval:
        return Interval(-self.mid, self.rad)

    def __add__(self, other: Interval) -> Interval:
        mid = self.mid + other.mid
        return Interval(mid, UP * (self.rad + other.rad + U * np.abs(mid)))

    def __sub__(self, other: Interval) -> Interval:
        return self + -other

    def __mul__(self, other: Interval) -> Interval:
        mid = self.mid * other.mid
        spread = np.abs(self.mid) * other.rad + self.rad * (np.abs(other.mid) + other.rad)
        return Interval(mid, UP * (spread + U * np.abs(mid) + TINY))

    def __truediv__(self, other: Interval) -> Interval:
        """Return the quotients; the divisors must not contain zero."""
        mid = self.mid / other.mid
        least = np.abs(other.mid) - UP * other.rad
        if not np.all(least > 0):
            raise ZeroDivisionError("an interval that contains zero")
        spread = (self.rad + np.abs(mid) * other.rad) / least
        return Interval(mid, UP * (UP * UP * spread + U * np.abs(mid) + TINY))

    def reshape(self, *shape: int) -> Interval:
        """Return the array with another shape."""
        return Interval(self.mid.reshape(shape), self.rad.reshape(shape))


def stack(parts: Sequence[Interval], axis: int = 0) -> Interval:
    """Return arrays of one shape, joined along a new axis."""
    return Interval(np.stack([part.mid for part in parts], axis), np.stack([part.rad for part in parts], axis))


def product(A: Interval, X: Interval, axis: int = 0) -> Interval:
    """Return the sums over j of A[i, j] X[.., j, ..] with j, then i, at `axis`; A (p, k).

    A sum of k products has an error of at most k u / (1 - k u) times the sum of their absolute values, in any order.
    """
    k = A.mid.shape[1]
    largest, gamma = np.abs(A.mid), (k + 1) * U
    mid = _along(A.mid, X.mid, axis)
    spread = _along(largest + A.rad, X.rad, axis) + _along(A.rad + gamma * largest, np.abs(X.mid), axis)
    return Interval(mid, (1 + (2 * k + 20) * U) * UP * (spread + TINY))


def _along(A: Array, X: Array, axis: int) -> Array:
    return np.moveaxis(np.asarray(np.tensordot(A, X, axes=(1, axis)), dtype=float), 0, axis)


def cosine(angle: Interval) -> Interval:
    """Return cos(angle); its slope is at most 1."""
    return Interval(np.cos(angle.mid), UP * (angle.rad + LIBRARY))


def sine(angle: Interval) -> Interval:
    """Return sin(angle); its slope is at most 1."""
    return Interval(np.sin(angle.mid), UP * (angle.rad + LIBRARY))
