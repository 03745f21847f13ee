# SPDX-License-Identifier: Apache-2.0
"""Intervals contain the exact results of the operations on every number that they contain (mpmath, 60 digits)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fjr_core.numerics.intervals import Interval, cosine, product, sine

finite = st.floats(-1e6, 1e6, allow_nan=False)
radius = st.floats(0.0, 1.0)
side = st.sampled_from([-1, 0, 1])


def contains(interval: Interval, value: Any) -> bool:
    return bool(abs(mpmath.mpf(float(interval.mid)) - value) <= mpmath.mpf(float(interval.rad)))


def member(mid: float, rad: float, at: int) -> Any:
    return mpmath.mpf(mid) + at * mpmath.mpf(rad)


def interval(mid: float, rad: float) -> Interval:
    return Interval(np.float64(mid), np.float64(rad))  # type: ignore[arg-type]


@pytest.mark.parametrize("operation", [lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b])
@given(finite, radius, side, finite, radius, side)
def test_sums_and_products(
    operation: Callable[[Any, Any], Any], a: float, ra: float, i: int, b: float, rb: float, k: int
) -> None:
    with mpmath.workdps(60):
        found = operation(interval(a, ra), interval(b, rb))
        assert contains(found, operation(member(a, ra, i), member(b, rb, k)))


@given(finite, radius, side, st.floats(0.5, 1e3), st.floats(0.0, 0.3), side)
def test_quotients(a: float, ra: float, i: int, b: float, rb: float, k: int) -> None:
    with mpmath.workdps(60):
        assert contains(interval(a, ra) / interval(b, rb), member(a, ra, i) / member(b, rb, k))


@given(st.floats(-10, 10), radius, side)
def test_cosines_and_sines(a: float, ra: float, i: int) -> None:
    with mpmath.workdps(60):
        assert contains(cosine(interval(a, ra)), mpmath.cos(member(a, ra, i)))
        assert contains(sine(interval(a, ra)), mpmath.sin(member(a, ra, i)))


@given(st.lists(st.tuples(finite, radius, side, finite, radius, side), min_size=1, max_size=6))
def test_inner_products(terms: list[tuple[float, float, int, float, float, int]]) -> None:
    a, ra, i, b, rb, k = (np.array(column) for column in zip(*terms, strict=True))
    with mpmath.workdps(60):
        exact = sum(member(t[0], t[1], t[2]) * member(t[3], t[4], t[5]) for t in terms)
        assert contains(product(Interval(a[None], ra[None]), Interval(b, rb))[0], exact)


def test_a_quotient_by_an_interval_with_zero_is_refused() -> None:
    with pytest.raises(ZeroDivisionError):
        interval(1.0, 0.0) / interval(0.1, 0.2)
