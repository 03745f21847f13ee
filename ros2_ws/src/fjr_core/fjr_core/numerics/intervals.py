# SPDX-License-Identifier: Apache-2.0
"""Verified numerics: interval arithmetic on arrays, definiteness, and eigenvalues of symmetric pencils.

Midpoint-radius intervals: a real number x is enclosed if |x - mid| <= rad. With u = 2^-53, an operation of IEEE double
precision in any rounding mode to nearest satisfies |fl(a o b) - a o b| <= u |fl(a o b)| + 2^-1074. Every operation adds
this error to the radius, and enlarges the radius by a factor that covers its own rounding. S. M. Rump, Verification
methods: rigorous results using floating-point arithmetic, Acta Numerica 19 (2010), sec. 9.

If the Cholesky factorisation of a symmetric matrix G (n, n) runs to completion, then the smallest eigenvalue of G is at
least -c trace(G) with c = gamma / (1 - gamma), gamma = (n + 1) u / (1 - (n + 1) u) (Demmel 1989; Rump, Verification of
positive definiteness, BIT 46, 2006). So G + c trace(G) I is positive semidefinite.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .checks import Array

U = 2.0**-53
"""Unit roundoff of double precision."""
TINY = 2.0**-1022
"""More than the error of any operation that underflows, times 2^50."""
UP = 1 + 2.0**-48
"""Factor that covers 15 roundings in the computation of a radius."""
LIBRARY = 8 * U
"""Bound of the error of sin and cos: 4 units in the last place of a number up to 1."""
CHUNK = 2048
"""Matrices that are factorised together; they fit into the cache."""
SHARE, GROWTH = 1e-13, 100.0
"""First distance of the bound from the eigenvalue that was found, relative to the matrix, and its growth."""


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


def trace_factor(n: int) -> float:
    """Return an upper bound of c for matrices (n, n), with underflow covered for traces above 1e-200."""
    return (n + 2) * U * (1 + 2.0**-40)


def factorisable(entries: Array, diagonal: float) -> NDArray[np.bool_]:
    """Return (k,): whether the Cholesky factorisation of diagonal I - N runs to completion for each of k matrices N.

    entries (n, n, k), symmetric: the matrices N.
    """
    n, k = entries.shape[1:]
    found = np.ones(k, dtype=bool)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for chunk in (slice(begin, begin + CHUNK) for begin in range(0, k, CHUNK)):
            G = -entries[..., chunk]
            for i in range(n):
                G[i, i] += diagonal
            for i in range(n):
                found[chunk] &= G[i, i] > TINY
                G[i, i:] /= np.sqrt(G[i, i])
                for j in range(i + 1, n):
                    G[j, j:] -= G[i, j] * G[i, j:]
    return found


def least_eigenvalue(A: Interval, B: Interval) -> float:
    """Return a number lambda that is proven to satisfy A >= lambda B; -infinity if rounding leaves none.

    A, B (n, n): symmetric, B positive definite. With X the inverse Cholesky factor of B, |X B X' - I| <= e < 1 and
    X A X' >= s I >= 0 give A >= s / (1 + e) B.
    """
    n, X = len(A.mid), Interval.exact(np.linalg.inv(np.linalg.cholesky(B.mid)))
    N = product(X, product(X, A), axis=1)
    error = _norm(product(X, product(X, B), axis=1) - Interval.exact(np.eye(n)))
    found, size, distance = float(np.linalg.eigvalsh(N.mid)[0]), _norm(N), SHARE
    while distance < 1:
        s = found - distance * size
        if factorisable(-N.mid[:, :, None], -s)[0]:
            slack = 2 * n * (trace_factor(n) + 2 * U) * (size + abs(s)) + _norm(Interval(0 * N.rad, N.rad))
            least = s - 1.01 * slack
            return float((1 - 1e-14) * least / (1 + error)) if least > 0 and error < 0.5 else -np.inf
        distance *= GROWTH
    return -np.inf


def _norm(A: Interval) -> float:
    """Return an upper bound of the norm of every symmetric matrix that A contains above the diagonal."""
    upper = np.triu(A.magnitude)
    return float(UP * UP * np.max(np.sum(upper + np.triu(upper, 1).T, axis=1)))
