# SPDX-License-Identifier: Apache-2.0
"""Control matrices of the link inertia on a box of joint positions; their convex hull contains M_l(q_l).

A polynomial in one joint is a convex combination of its control values at every point of a range: each basis below is
nonnegative and has the sum 1.

- an arc shorter than pi: the normalised B-basis of the trigonometric polynomials of degree 2. They are homogeneous
  quartic polynomials in (cos(q/2), sin(q/2)), whose blossom at (a, .., a, b, .., b) gives the control values, divided
  by the blossom of 1. J. M. Pena, Shape preserving representations for trigonometric polynomial curves, CAGD 14 (1997).
- the whole circle: five copies of a nonnegative kernel 1 + 2 k_1 cos q + 2 k_2 cos 2q, turned by 72 degrees each.
- an interval of a prismatic joint: the Bernstein basis of degree 2.

All matrices from coefficients to control values, and from those of a range to those of its parts, have entries that are
intervals and contain the exact values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from math import comb

import numpy as np

from fjr_core.errors import RobotError
from fjr_core.numerics.checks import Array
from fjr_core.numerics.intervals import UP, Interval, U, cosine, product, sine, stack

from .inertia_polynomial import from_nodes, pairs, waves

LONGEST_ARC = 2.5
"""Longest arc [rad] with control values of its own; a longer one is part of the whole circle."""
DEGREE = 4
"""Of a trigonometric polynomial of degree 2 in the half angle."""
KERNEL = Interval.exact([1.0, 0.65, 0.65, 0.34, 0.34])
"""1, k_1, k_1, k_2, k_2; nonnegative as 1 - 2 k_2 - k_1^2 / (4 k_2) > 0."""
CACHED = 4096
"""Matrices that are kept: halves of halves have few different ends."""
ONE, HALF = Interval.exact(1.0), Interval.exact(0.5)


@lru_cache(CACHED)
def from_arc(a: float, b: float) -> Interval:
    """Return (5, 5): coefficients of (1, cos, sin, cos 2q, sin 2q) to control values on the arc from a to b [rad]."""
    alpha, beta, weights = Interval.exact(a / 2), Interval.exact(b / 2), _weights(a, b)
    rows = []
    for k in range(DEGREE + 1):
        waves = [wave for order in (1, 2) for wave in _blossom(alpha, beta, k, order)]
        rows.append(stack([ONE, *(wave / weights[k] for wave in waves)]))
    return stack(rows)


@lru_cache(CACHED)
def from_interval(a: float, b: float) -> Interval:
    """Return (3, 3): coefficients of (1, q, q^2) to control values on the interval from a to b [m]."""
    left, right = Interval.exact(a), Interval.exact(b)
    middle = stack([ONE, (left + right) * HALF, left * right])
    return stack([stack([ONE, left, left * left]), middle, stack([ONE, right, right * right])])


@lru_cache(CACHED)
def from_circle() -> Interval:
    """Return (5, 5): coefficients of (1, cos, sin, cos 2q, sin 2q) to control values on the whole circle."""
    weighted = waves() / KERNEL[:, None]
    return stack([weighted[:, j] for j in range(5)])


@lru_cache(CACHED)
def circle_to_arc(a: float, b: float) -> Interval:
    """Return (5, 5): control values on the whole circle to those on the arc from a to b [rad]."""
    return product(from_arc(a, b), KERNEL[:, None] * from_nodes(False))


@lru_cache(CACHED)
def to_parts(a: float, middle: float, b: float, prismatic: bool) -> tuple[Interval, Interval]:
    """Return two matrices: control values on [a, b] to those on [a, middle] and on [middle, b] (de Casteljau)."""
    left, right = _difference(middle, a), _difference(b, middle)
    if prismatic:
        degree, whole, before, after = 2, _difference(b, a), [ONE] * 3, ([ONE] * 3, [ONE] * 3)
    else:
        degree, whole = DEGREE, sine(_difference(b, a) * HALF)
        left, right = sine(left * HALF), sine(right * HALF)
        before, after = _weights(a, b), (_weights(a, middle), _weights(middle, b))
    mu, lam = _powers(left / whole, degree), _powers(right / whole, degree)
    zero = Interval.exact(0.0)

    def entry(row: int, column: int, part: int) -> Interval:
        steps, k = (row, column) if part == 0 else (degree - row, column - row)
        if not 0 <= k <= steps:
            return zero
        return Interval.exact(comb(steps, k)) * lam[steps - k] * mu[k] * before[column] / after[part][row]

    first, second = (
        stack([stack([entry(row, column, part) for column in range(degree + 1)]) for row in range(degree + 1)])
        for part in (0, 1)
    )
    return first, second


def _weights(a: float, b: float) -> list[Interval]:
    """Return the blossom (5,) of the polynomial 1 = (x_0^2 + x_1^2)^2 on the arc from a to b; all positive below pi."""
    c = cosine(_difference(b, a) * HALF)
    central = (ONE + c * c + c * c) / Interval.exact(3.0)
    return [ONE, c, central, c, ONE]


def _blossom(alpha: Interval, beta: Interval, k: int, order: int) -> tuple[Interval, Interval]:
    """Return the blossoms of cos(order q) and sin(order q) at 4 - k half angles alpha and k half angles beta.

    exp(i order q) = z^(2 + order) / z^(2 - order) with z = exp(i q / 2): the mean over all choices of the 2 - order
    arguments that divide.
    """
    dividing = DEGREE // 2 - order
    real = imaginary = Interval.exact(0.0)
    for m in range(max(0, dividing - DEGREE + k), min(k, dividing) + 1):
        ways = comb(k, m) * comb(DEGREE - k, dividing - m) / comb(DEGREE, dividing)  # a multiple of 1/4: exact
        angle = alpha * Interval.exact(DEGREE - k - 2.0 * (dividing - m)) + beta * Interval.exact(k - 2.0 * m)
        real, imaginary = real + Interval.exact(ways) * cosine(angle), imaginary + Interval.exact(ways) * sine(angle)
    return real, imaginary


def _difference(larger: float, smaller: float) -> Interval:
    return Interval.exact(larger) - Interval.exact(smaller)


def _powers(value: Interval, degree: int) -> list[Interval]:
    powers = [ONE]
    for _ in range(degree):
        powers.append(powers[-1] * value)
    return powers


@dataclass(frozen=True, eq=False)
class NormalisedInertia:
    """The polynomial N(q) = X M_l(q) X', with X the inverse Cholesky factor of a positive definite matrix A.

    coefficients (n (n + 1) / 2, d_2, .., d_n): of the entries i <= j. rad (n (n + 1) / 2,): bound of their errors.
    prismatic (n - 1,): of the joints 2 .. n, which are the axes. identity_error: bound of the norm of X A X' - I.
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


def normalised(M: Interval, prismatic: tuple[bool, ...], A: Interval) -> NormalisedInertia:
    """Return X M_l X' for a symmetric positive definite matrix A (n, n); raise RobotError if it is singular.

    M: coefficients of M_l. prismatic: as of NormalisedInertia.
    """
    n = len(A.mid)
    X = Interval.exact(np.linalg.inv(np.linalg.cholesky(A.mid)))
    E = product(X, product(X, A), axis=1) - Interval.exact(np.eye(n))
    error = float(UP * np.max(np.sum(E.magnitude, axis=1)))
    if not error < 1e-3:
        raise RobotError(f"A has the condition number {np.linalg.cond(A.mid):.3g}; expected a well-conditioned matrix")
    i, j = np.transpose(pairs(n))[:, :, None]
    k, m = np.transpose(pairs(n))[:, None, :]
    both = Interval.exact(np.where(k == m, 0.0, 1.0))
    congruence = X[i, k] * X[j, m] + both * X[i, m] * X[j, k]
    rad, largest = (np.max(part.reshape(len(part), -1), axis=1) for part in (M.rad, np.abs(M.mid)))
    size, gamma = np.abs(congruence.mid) + congruence.rad, (len(rad) + 1) * U
    errors = size @ rad + (congruence.rad + gamma * size) @ (largest + rad)
    values = along(congruence.mid, M.mid, 0)
    return NormalisedInertia(values, (1 + 4 * gamma) * UP * errors, prismatic, X.mid, error)


@dataclass(frozen=True, eq=False)
class ControlMatrices:
    """Control matrices of N on a box of the joints 2 .. n.

    box (n - 1, 2): ranges [rad, m]. circles (n - 1,): whether a joint has control values of the whole circle.
    values (n (n + 1) / 2, d_2, .., d_n): the entries i <= j. rad (n (n + 1) / 2,): bound of their errors.
    """

    inertia: NormalisedInertia
    box: Array
    circles: tuple[bool, ...]
    values: Array
    rad: Array

    @property
    def matrices(self) -> Array:
        """All control matrices (n, n, k)."""
        return _symmetric(self.values.reshape(len(self.values), -1), self.inertia.n)

    @property
    def error(self) -> float:
        """Bound of the norm of the error of any control matrix."""
        return float(UP * np.max(np.sum(_symmetric(self.rad, self.inertia.n), axis=1)))

    def cuts(self, axis: int) -> Array:
        """Return the ends (k + 1,) of the parts into which the range of a joint is split: two halves, or arcs."""
        a, b = self.box[axis]
        return np.linspace(a, b, int(np.ceil((b - a) / LONGEST_ARC)) + 1 if self.circles[axis] else 3)

    def maps(self, axis: int) -> list[Interval]:
        """Return the matrices from control values on the range of a joint to those on its parts."""
        ends = [float(end) for end in self.cuts(axis)]
        if self.circles[axis]:
            return [circle_to_arc(a, b) for a, b in pairwise(ends)]
        return list(to_parts(*ends, self.inertia.prismatic[axis]))

    def parts(self, axis: int) -> list[ControlMatrices]:
        """Return the control matrices on the parts of the box that is split in one joint."""
        return [self.mapped(axis, A, ends) for A, ends in zip(self.maps(axis), pairwise(self.cuts(axis)), strict=True)]

    def mapped(self, axis: int, matrix: Interval, ends: tuple[float, float], circle: bool = False) -> ControlMatrices:
        """Return the values times a matrix in one joint, with the new range of this joint."""
        box, circles = self.box.copy(), list(self.circles)
        box[axis], circles[axis] = ends, circle
        k, largest = len(matrix.mid), np.max(np.abs(self.values).reshape(len(self.values), -1), axis=1)
        sums = np.max(np.sum(np.abs(matrix.mid) + matrix.rad, axis=1))
        errors = np.max(np.sum(matrix.rad + (k + 1) * U * np.abs(matrix.mid), axis=1))
        rad = UP * UP * (sums * self.rad + errors * (largest + self.rad))
        values = along(matrix.mid, self.values, axis + 1)
        return replace(self, box=box, circles=tuple(circles), values=values, rad=rad)


def control_matrices(
    inertia: NormalisedInertia, box: Array, circles: tuple[bool, ...] | None = None
) -> ControlMatrices:
    """Return the control matrices on a box (n - 1, 2) [rad, m].

    circles: as of ControlMatrices; by default the joints whose range is longer than LONGEST_ARC.
    """
    if circles is None:
        long = np.ptp(box, axis=1) > LONGEST_ARC
        circles = tuple(bool(turns) for turns in long & ~np.array(inertia.prismatic, dtype=bool))
    result = ControlMatrices(inertia, box, circles, inertia.coefficients, inertia.rad)
    for axis, circle in enumerate(circles):
        a, b = (float(end) for end in box[axis])
        matrix = from_circle() if circle else (from_interval if inertia.prismatic[axis] else from_arc)(a, b)
        result = result.mapped(axis, matrix, (a, b), circle)
    return result


def along(matrix: Array, values: Array, axis: int) -> Array:
    """Return the sums over j of matrix[i, j] values[.., j, ..] with j, then i, at `axis`; C-contiguous."""
    shape = values.shape
    sums = np.matmul(matrix, values.reshape(int(np.prod(shape[:axis])), shape[axis], -1))
    return sums.reshape(shape)


def _symmetric(entries: Array, n: int) -> Array:
    """Return symmetric matrices (n, n, ..) of the entries i <= j (n (n + 1) / 2, ..)."""
    matrices = np.empty((n, n, *entries.shape[1:]))
    for row, (i, j) in zip(entries, pairs(n), strict=True):
        matrices[i, j] = matrices[j, i] = row
    return matrices
