# SPDX-License-Identifier: Apache-2.0
"""Text in one line: names of joints wherever they enter, which must be printable, and bounds, which hold as printed."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

import fjr_core as fjr
from fjr_core.config.parameter import complete
from fjr_core.config.robot import robot, robot_parameters
from fjr_core.errors import FjrError
from fjr_core.numerics.one_line import at_least, at_most
from fjr_core.runtime.safety_settings import Settings
from fuzzing import fuzzed
from two_link_urdf import two_link_urdf


def from_parameters(names: list[str]) -> fjr.Robot:
    given = {"robot.model": "planar_two_link", "joints": names}
    return robot(complete(robot_parameters(given), given))


ENTRIES: dict[str, Callable[[list[str]], object]] = {
    "parameters": from_parameters,
    "URDF": lambda names: fjr.robot_from_urdf(two_link_urdf(), names, 400.0, 0.1),
    "settings": lambda names: Settings(tuple(names)),
}
NOT_PRINTABLE = st.characters(categories=("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"))
NAMES = st.text(st.characters(categories=("L", "N", "P", "S")), min_size=1, max_size=8)
BAD = st.one_of(
    st.just(["a", ""]),
    st.just([]),
    NAMES.map(lambda name: [name, name]),
    NAMES.map(lambda name: [name, f"{name}_motor"]),
    NAMES.map(lambda name: ["other name", f" {name}"]),
    st.tuples(NAMES, NOT_PRINTABLE, NAMES).map(lambda parts: ["other name", "".join(parts)]),
)


@pytest.mark.parametrize("entry", ENTRIES)
@fuzzed(50)
@given(names=BAD)
def test_bad_names_are_refused_in_one_printable_sentence(entry: str, names: list[str]) -> None:
    with pytest.raises(FjrError) as refused:
        ENTRIES[entry](names)
    assert str(refused.value).isprintable()
    assert re.search(r"(expected|; )", str(refused.value))


@fuzzed(50)
@given(
    names=st.tuples(NAMES, NAMES).filter(lambda pair: pair[0] != pair[1] and not {f"{n}_motor" for n in pair} & {*pair})
)
def test_other_names_are_accepted(names: tuple[str, str]) -> None:
    given = {"robot.model": "planar_two_link", "joints": list(names)}
    assert Settings(names).joints == names
    assert tuple(complete(robot_parameters(given), given)["joints"]) == names


@pytest.mark.parametrize("tag", ["joint", "link"])
def test_a_urdf_with_a_name_that_cannot_be_printed_is_refused(tag: str) -> None:
    name = re.search(rf'<{tag} name="([^"]+)"', two_link_urdf())[1]
    text = two_link_urdf().replace(f'"{name}"', f'"{name}&#8238;"')
    with pytest.raises(FjrError, match="expected names of printable characters"):
        fjr.robot_from_urdf(text, ["shoulder", "elbow"], 400.0, 0.1)


@given(bound=st.floats(-1e12, 1e12, allow_subnormal=False), digits=st.integers(1, 6))
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
