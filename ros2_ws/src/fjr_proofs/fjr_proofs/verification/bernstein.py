# SPDX-License-Identifier: Apache-2.0
"""Matrices from coefficients of a polynomial in one joint to its control values, and from a range to parts of it.

A polynomial is a convex combination of its control values at every point of the range, so that their convex hull
contains it. Ranges and bases, each nonnegative and with the sum 1:

- an arc shorter than pi: the normalised B-basis of the trigonometric polynomials of degree 2. They are homogeneous
  quartic polynomials in (cos(q/2), sin(q/2)), whose blossom at (a, .., a, b, .., b) gives the control values, divided
  by the blossom of 1. J. M. Pena, Shape preserving representations for trigonometric polynomial curves, CAGD 14 (1997).
- the whole circle: five copies of a nonnegative kernel 1 + 2 k_1 cos q + 2 k_2 cos 2q, turned by 72 degrees each.
- an interval of a prismatic joint: the Bernstein basis of degree 2.

All entries are intervals that contain the exact values.
"""

from __future__ import annotations

from functools import lru_cache
from math import comb, pi

import numpy as np

from fjr_core.numerics.intervals import Interval, U, cosine, product, sine, stack

DEGREE = 4
"""Of a trigonometric polynomial of degree 2 in the half angle."""
KERNEL = (1.0, 0.65, 0.34)
"""Cosine coefficients; nonnegative as 1 - 2 k_2 - k_1^2 / (4 k_2) > 0."""
CACHED = 4096
"""Matrices that are kept: halves of halves have few different ends."""
ONE, HALF = Interval.exact(1.0), Interval.exact(0.5)


@lru_cache(CACHED)
def from_arc(a: float, b: float) -> Interval:
    """Return (5, 5): coefficients of (1, cos, sin, cos 2q, sin 2q) to control values on the arc from a to b [rad]."""
    alpha, beta, weights = Interval.exact(a / 2), Interval.exact(b / 2), _weights(a, b)
    rows = []
    for k in range(DEGREE + 1):
        values = [ONE]
        for order in (1, 2):
            parts = _blossom(alpha, beta, k, order)
            values += [part / weights[k] for part in parts]
        rows.append(stack(values))
    return stack(rows)


@lru_cache(CACHED)
def from_interval(a: float, b: float) -> Interval:
    """Return (3, 3): coefficients of (1, q, q^2) to control values on the interval from a to b [m]."""
    left, right = Interval.exact(a), Interval.exact(b)
    return stack(
        [
            stack([ONE, left, left * left]),
            stack([ONE, (left + right) * HALF, left * right]),
            stack([ONE, right, right * right]),
        ]
    )


@lru_cache(CACHED)
def from_circle() -> Interval:
    """Return (5, 5): coefficients of (1, cos, sin, cos 2q, sin 2q) to control values on the whole circle."""
    return stack([stack([ONE, *_waves(j, inverse=True)]) for j in range(5)])


@lru_cache(CACHED)
def circle_to_arc(a: float, b: float) -> Interval:
    """Return (5, 5): control values on the whole circle to those on the arc from a to b [rad]."""
    fifth = Interval.exact(1.0) / Interval.exact(5.0)
    columns = [stack([fifth, *(wave * (fifth + fifth) for wave in _waves(j, inverse=False))]) for j in range(5)]
    return product(from_arc(a, b), stack(columns, axis=1))


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


def _waves(j: int, inverse: bool) -> list[Interval]:
    """Return cos and sin of 72 j degrees and of twice this angle, times or divided by the kernel's coefficients."""
    found = []
    for order in (1, 2):
        angle = 2 * pi * (order * j) / 5
        turned, weight = Interval(np.asarray(angle), np.asarray(8 * U * angle)), Interval.exact(KERNEL[order])
        found += [wave / weight if inverse else wave * weight for wave in (cosine(turned), sine(turned))]
    return found


def _difference(larger: float, smaller: float) -> Interval:
    return Interval.exact(larger) - Interval.exact(smaller)


def _powers(value: Interval, degree: int) -> list[Interval]:
    found = [ONE]
    for _ in range(degree):
        found.append(found[-1] * value)
    return found
