# SPDX-License-Identifier: Apache-2.0
"""Control matrices of the link inertia on a box of joint positions; their convex hull contains M_l(q_l)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fjr_core.errors import RobotError
from fjr_core.numerics.checks import Array
from fjr_core.numerics.intervals import UP, Interval, U, product

from . import bernstein
from .inertia_polynomial import InertiaPolynomial, pairs

LONGEST_ARC = 2.5
"""Longest arc [rad] with control values of its own; a longer one is part of the whole circle."""


@dataclass(frozen=True, eq=False)
class NormalisedInertia:
    """The polynomial N(q) = sign X M_l(q) X', with X the inverse Cholesky factor of a positive definite matrix A.

    coefficients (n (n + 1) / 2, d_2, .., d_n): as of InertiaPolynomial. rad (n (n + 1) / 2,): bound of their errors.
    identity_error: bound of the norm of X A X' - I.
    """

    coefficients: Array
    rad: Array
    prismatic: tuple[bool, ...]
    X: Array
    identity_error: float

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.prismatic) + 1


def normalised(polynomial: InertiaPolynomial, A: Interval, sign: float = 1.0) -> NormalisedInertia:
    """Return sign X M_l X' for a symmetric positive definite matrix A (n, n); raise RobotError if it is singular."""
    n, M = polynomial.n, polynomial.coefficients
    X = Interval.exact(np.linalg.inv(np.linalg.cholesky(A.mid)))
    E = product(X, product(X, A), axis=1) - Interval.exact(np.eye(n))
    error = float(UP * np.max(np.sum(E.magnitude, axis=1)))
    if not error < 1e-3:
        raise RobotError(f"A has the condition number {np.linalg.cond(A.mid):.3g}; expected a well-conditioned matrix")
    i, j = np.transpose(pairs(n))[:, :, None]
    k, m = np.transpose(pairs(n))[:, None, :]
    both = Interval.exact(np.where(k == m, 0.0, 1.0))
    congruence = X[i, k] * X[j, m] + both * X[i, m] * X[j, k]
    values, rad = _mapped(congruence, M.mid, np.max(M.rad.reshape(len(M.rad), -1), axis=1))
    return NormalisedInertia(sign * values, rad, polynomial.prismatic, X.mid, error)


def _mapped(matrix: Interval, values: Array, rad: Array) -> tuple[Array, Array]:
    """Return a matrix (p, p) times values (p, ..), and the bounds (p,) of the errors of its rows."""
    largest = np.max(np.abs(values).reshape(len(values), -1), axis=1)
    size, gamma = np.abs(matrix.mid) + matrix.rad, (len(values) + 1) * U
    errors = size @ rad + (matrix.rad + gamma * size) @ (largest + rad)
    return along(matrix.mid, values, 0), (1 + 4 * gamma) * UP * errors


@dataclass(frozen=True, eq=False)
class ControlMatrices:
    """Control matrices of N on a box of the joints 2 .. n.

    box (n - 1, 2): ranges [rad, m]. circles (n - 1,): whether a joint has control values of the whole circle.
    values (n (n + 1) / 2, d_2, .., d_n): the entries i <= j. rad (n (n + 1) / 2,): bound of their errors.
    """

    box: Array
    circles: tuple[bool, ...]
    values: Array
    rad: Array

    @property
    def matrices(self) -> Array:
        """All control matrices (n, n, k)."""
        flat = self.values.reshape(len(self.values), -1)
        n = self.values.ndim
        found = np.empty((n, n, flat.shape[1]))
        for row, (i, j) in zip(flat, pairs(n), strict=True):
            found[i, j] = found[j, i] = row
        return found

    @property
    def error(self) -> float:
        """Bound of the norm of the error of any control matrix."""
        n = self.values.ndim
        bound = np.zeros((n, n))
        for rad, (i, j) in zip(self.rad, pairs(n), strict=True):
            bound[i, j] = bound[j, i] = rad
        return float(UP * np.max(np.sum(bound, axis=1)))

    def cuts(self, axis: int) -> Array:
        """Return the ends (k + 1,) of the parts into which the range of a joint is split: two halves, or arcs."""
        a, b = self.box[axis]
        return np.linspace(a, b, int(np.ceil((b - a) / LONGEST_ARC)) + 1 if self.circles[axis] else 3)

    def maps(self, axis: int, inertia: NormalisedInertia) -> list[Interval]:
        """Return the matrices from control values on the range of a joint to those on its parts."""
        ends = [float(end) for end in self.cuts(axis)]
        if self.circles[axis]:
            return [bernstein.circle_to_arc(a, b) for a, b in pairwise(ends)]
        return list(bernstein.to_parts(*ends, inertia.prismatic[axis]))

    def parts(self, axis: int, inertia: NormalisedInertia) -> list[ControlMatrices]:
        """Return the control matrices on the parts of the box that is split in one joint."""
        ends = pairwise(self.cuts(axis))
        return [self.mapped(axis, A, pair) for A, pair in zip(self.maps(axis, inertia), ends, strict=True)]

    def mapped(self, axis: int, matrix: Interval, ends: tuple[float, float], circle: bool = False) -> ControlMatrices:
        """Return the values times a matrix in one joint, with the new range of this joint."""
        box, circles = self.box.copy(), list(self.circles)
        box[axis], circles[axis] = ends, circle
        k, largest = len(matrix.mid), np.max(np.abs(self.values).reshape(len(self.values), -1), axis=1)
        sums = np.max(np.sum(np.abs(matrix.mid) + matrix.rad, axis=1))
        errors = np.max(np.sum(matrix.rad + (k + 1) * U * np.abs(matrix.mid), axis=1))
        rad = UP * UP * (sums * self.rad + errors * (largest + self.rad))
        return ControlMatrices(box, tuple(circles), along(matrix.mid, self.values, axis + 1), rad)


def control_matrices(inertia: NormalisedInertia, box: Array, circles: tuple[bool, ...]) -> ControlMatrices:
    """Return the control matrices on a box (n - 1, 2) [rad, m]; circles: as of ControlMatrices."""
    found = ControlMatrices(box, circles, inertia.coefficients, inertia.rad)
    for axis, circle in enumerate(circles):
        a, b = (float(end) for end in box[axis])
        if circle:
            matrix = bernstein.from_circle()
        else:
            matrix = (bernstein.from_interval if inertia.prismatic[axis] else bernstein.from_arc)(a, b)
        found = found.mapped(axis, matrix, (a, b), circle)
    return found


def whole_circles(inertia: NormalisedInertia, box: Array) -> tuple[bool, ...]:
    """Return for each joint (n - 1,) whether its range is so long that it has the control values of the circle."""
    return tuple(
        not prismatic and b - a > LONGEST_ARC for prismatic, (a, b) in zip(inertia.prismatic, box, strict=True)
    )


def along(matrix: Array, values: Array, axis: int) -> Array:
    """Return the sums over j of matrix[i, j] values[.., j, ..] with j, then i, at `axis`; C-contiguous."""
    shape = values.shape
    found = np.matmul(matrix, values.reshape(int(np.prod(shape[:axis])), shape[axis], -1))
    return found.reshape(shape)
