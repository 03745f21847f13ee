# SPDX-License-Identifier: Apache-2.0
"""Symbolic operations on CasADi SX expressions."""

from __future__ import annotations

import casadi as ca
from numpy.typing import ArrayLike


def symbols(kind: type = ca.SX, **rows: int) -> dict[str, ca.SX]:
    """Return column symbols of the given numbers of rows by name."""
    return {name: kind.sym(name, size) for name, size in rows.items()}  # type: ignore[attr-defined]


def blocks(x: ca.SX, n: int) -> list[ca.SX]:
    """Split a state (4n,) into its four blocks (q_l, q_m, p_l, p_m), each (n,)."""
    return ca.vertsplit(x, n)


def solve(A: ca.SX | ca.DM, b: ca.SX) -> ca.SX:
    """Return A^-1 b for a symmetric positive definite A (n, n), by its LDL' factors."""
    if A.shape == (1, 1):
        return b / A
    return ca.ldl_solve(b, *ca.ldl(ca.SX(A)))


def sparse(matrix: ca.SX | ArrayLike) -> ca.SX:
    """Return a numeric or symbolic matrix with structural zeros removed."""
    return ca.sparsify(matrix if isinstance(matrix, ca.SX) else ca.SX(ca.DM(matrix)))


def directional(e: ca.SX, z: ca.SX, dz: ca.SX) -> ca.SX:
    """Return the derivative of e(z) in the direction dz, in one sweep over the whole of e."""
    return ca.jtimes(e, z, dz)
