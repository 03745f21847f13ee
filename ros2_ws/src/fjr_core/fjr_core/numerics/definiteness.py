# SPDX-License-Identifier: Apache-2.0
"""Prove that symmetric matrices are positive semidefinite, by Cholesky factorisations in floating point.

If the factorisation of a symmetric matrix G (n, n) runs to completion, then the smallest eigenvalue of G is at least
-c trace(G) with c = gamma / (1 - gamma), gamma = (n + 1) u / (1 - (n + 1) u) (Demmel 1989; Rump, Verification of
positive definiteness, BIT 46, 2006). So G + c trace(G) I is positive semidefinite.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .checks import Array
from .intervals import TINY, U

CHUNK = 2048
"""Matrices that are factorised together; they fit into the cache."""


def trace_factor(n: int) -> float:
    """Return an upper bound of c for matrices (n, n), with underflow covered for traces above 1e-200."""
    return (n + 2) * U * (1 + 2.0**-40)


def factorisable(entries: Array, diagonal: float) -> NDArray[np.bool_]:
    """Return (k,): whether the Cholesky factorisation of diagonal I - N runs to completion for each of k matrices N.

    entries (n, n, k), symmetric: the matrices N.
    """
    k = entries.shape[-1]
    found = np.zeros(k, dtype=bool)
    for begin in range(0, k, CHUNK):
        found[begin : begin + CHUNK] = _factorisable(entries[..., begin : begin + CHUNK], diagonal)
    return found


def _factorisable(entries: Array, diagonal: float) -> NDArray[np.bool_]:
    n, G = len(entries), -entries
    for i in range(n):
        G[i, i] += diagonal
    found = np.ones(G.shape[-1], dtype=bool)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for i in range(n):
            found &= G[i, i] > TINY
            G[i, i:] /= np.sqrt(G[i, i])
            for j in range(i + 1, n):
                G[j, j:] -= G[i, j] * G[i, j:]
    return found
