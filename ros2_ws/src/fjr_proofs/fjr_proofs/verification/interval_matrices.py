# SPDX-License-Identifier: Apache-2.0
"""Verified computations with stacks of small matrices: products, matrix exponentials, spectral norms.

A nonnegative expression, evaluated with nonnegative numbers only, has a relative error of at most the number of its
roundings times u; the factor ABOVE covers more than 10^3 roundings of each number.
"""

from __future__ import annotations

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_core.numerics.intervals import UP, Interval, U, factorisable, trace_factor

ABOVE = 1 + 1e-12
TERMS = 14
"""Terms of a matrix exponential; the remainder is bounded."""
EXCESS = 1e-7
"""Relative distance of a bound of a spectral norm from its value."""
TRIALS = 4


def matmul(A: Interval, B: Interval) -> Interval:
    """Return the products A[k] B[k] of stacks of matrices (k, p, m) and (k, m, q)."""
    gamma = (A.mid.shape[-1] + 1) * U
    mid, largest, factor = A.mid @ B.mid, np.abs(A.mid), np.abs(B.mid)
    spread = (largest + A.rad) @ B.rad + (A.rad + gamma * largest) @ factor
    return Interval(mid, ABOVE * (spread + 1e-300))


def exponential(A: Array, t: float) -> Interval:
    """Return exp(A[k] t) for a stack A (k, m, m), t >= 0 [s]; the norms of A t must be below 1 in some scaling."""
    return _exponential_series(A, t, 0)


def exponential_integral(A: Array, t: float) -> Interval:
    """Return the integral of exp(A[k] s) over s from 0 to t [s]; see exponential."""
    return _exponential_series(A, t, 1) * Interval.exact(t)


def _exponential_series(A: Array, t: float, missing: int) -> Interval:
    """Return the sum of (A t)^i missing! / (i + missing)!, missing = 0 or 1."""
    one = Interval.exact(np.broadcast_to(np.eye(A.shape[-1]), A.shape))
    X, total = Interval.exact(A) * Interval.exact(t), one
    for i in range(TERMS + missing, missing, -1):
        total = matmul(X, total) / Interval.exact(float(i)) + one
    return Interval(total.mid, UP * (total.rad + remainder(np.abs(A), t)))


def growth(A: Array, t: float) -> Array:
    """Return upper bounds (k, m, m) of exp(A t) - I for nonnegative A (k, m, m)."""
    term = total = A * t
    for i in range(2, TERMS + 1):
        term = term @ A * (t / i)
        total = total + term
    return np.asarray(ABOVE * total + remainder(A, t))


def excess(A: Array, R: Array, first: Array, t: float) -> Array:
    """Return upper bounds of exp((A + R) t) - exp(A t) - (R - first) t for nonnegative A, R, first (k, m, m).

    They bound the deviation of a fundamental matrix over t, whose generator differs from a constant by at most R, from
    the exponential; of the part of first order in the deviation only `first` is counted.
    """
    power, difference, total, factor = A, R, first * t, t
    for i in range(2, TERMS + 1):
        difference = (A + R) @ difference + R @ power
        power, factor = A @ power, factor * t / i
        total = total + difference * factor
    return np.asarray(ABOVE * total + remainder(A + R, t))


def remainder(A: Array, t: float) -> Array:
    """Return upper bounds of the terms of exp(A t) beyond TERMS, for nonnegative A (k, m, m).

    With A w <= theta w for a positive vector w, A^i <= theta^i w (1 / w)'. The sum of (theta t)^i / i! beyond TERMS is
    at most exp(theta t) times its first term. w = (I - A / sigma)^-1 1, sigma a little more than twice the spectral
    radius, so that A w <= sigma w up to rounding.
    """
    sigma = 1.0 + 2 * np.abs(np.linalg.eigvals(A)).max(axis=1)
    w = np.linalg.solve(np.eye(A.shape[-1]) - A / sigma[:, None, None], np.ones((*A.shape[:2], 1)))[:, :, 0]
    w = np.maximum(w, 1.0)
    theta = ABOVE * t * np.max((A @ w[:, :, None])[:, :, 0] / w, axis=1)
    size = theta.copy()
    for i in range(2, TERMS + 2):
        size = size * theta / i
    return np.asarray(ABOVE * (size * np.exp(theta))[:, None, None] * (w[:, :, None] / w[:, None, :]))


def spectral_norm(Y: Array) -> Array:
    """Return upper bounds (k,) of the spectral norms of Y (k, p, q).

    lambda_max(N) <= 1 is proven for N = Y Y' / t^2 by a Cholesky factorisation of I - N. t is found in floating point.
    Where the proof fails, the bound is the Frobenius norm.
    """
    if Y.shape[1] > Y.shape[2]:
        Y = np.swapaxes(Y, 1, 2)
    p, q = Y.shape[1:]
    gram = Y @ np.swapaxes(Y, 1, 2)
    trace = np.trace(gram, axis1=1, axis2=2)
    frobenius = np.sqrt(ABOVE * trace)
    t = np.sqrt(np.maximum(np.linalg.eigvalsh(gram)[:, -1], 0)) * (1 + EXCESS) + 1e-150
    proven = np.zeros(len(Y), dtype=bool)
    for _ in range(TRIALS):
        left = np.flatnonzero(~proven)
        N = np.moveaxis(gram[left] / t[left, None, None] ** 2, 0, -1)
        proven[left] = factorisable(N, 1.0)
        t[left] *= np.where(proven[left], 1.0, 1 + EXCESS)
    rounding = p * trace_factor(p) + (q + 8) * U * trace / t**2
    return np.asarray(np.where(proven, np.minimum(t * np.sqrt(1 + rounding) * ABOVE, frobenius), frobenius))


def magnitude_norm(Y: Array) -> Array:
    """Return upper bounds (k,) of the spectral norms of all matrices that are at most Y (k, p, q) in each entry."""
    return np.asarray(ABOVE * np.sqrt(np.max(Y.sum(axis=1), axis=1) * np.max(Y.sum(axis=2), axis=1)))
