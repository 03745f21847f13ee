# SPDX-License-Identifier: Apache-2.0
"""A bound that is printed is a bound: lower bounds are rounded down, upper bounds up."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from fjr_core.numerics.one_line import at_least, at_most

DIGITS = st.integers(1, 6)


@given(bound=st.floats(-1e12, 1e12, allow_subnormal=False), digits=DIGITS)
def test_printed_bounds_hold_and_lose_less_than_a_digit(bound: float, digits: int) -> None:
    lower, upper, slack = float(at_least(bound, digits)), float(at_most(bound, digits)), 1e-12 * abs(bound)
    unit = 10.0 ** (math.floor(math.log10(abs(bound))) - digits + 1) if bound else 0.0
    assert bound - 1.01 * unit <= lower <= bound + slack
    assert bound - slack <= upper <= bound + 1.01 * unit


def test_a_bound_that_is_a_short_number_but_for_rounding_is_printed_as_it() -> None:
    assert at_least(10 * (1 - 2.0**-52)) == at_most(10 * (1 + 2.0**-52)) == "10"
    assert (at_least(0.66789, 3), at_most(8.1612)) == ("0.667", "8.17")
    assert at_least(math.inf) == at_most(math.inf) == "inf"
    assert at_least(math.nan) == "nan"
