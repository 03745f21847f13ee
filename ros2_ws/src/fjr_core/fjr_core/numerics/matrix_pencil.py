# SPDX-License-Identifier: Apache-2.0
"""Prove a lower bound of the eigenvalues of a symmetric pencil, A v = lambda B v, in spite of rounding."""

from __future__ import annotations

import numpy as np

from .definiteness import factorisable, trace_factor
from .intervals import UP, Interval, U, product

SHARE, GROWTH = 1e-13, 100.0
"""First distance of the bound from the eigenvalue that was found, relative to the matrix, and its growth."""


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
