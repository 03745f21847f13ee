# SPDX-License-Identifier: Apache-2.0
"""Names of joints are refused in one sentence wherever they enter: parameters, URDF, settings."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

import fjr_core as fjr
from fjr_core.config.parameter import complete
from fjr_core.config.robot import robot, robot_parameters
from fjr_core.errors import FjrError
from fjr_core.runtime.safety_settings import Settings
from two_link_urdf import two_link_urdf

ENTRIES: dict[str, Callable[[list[str]], object]] = {
    "parameters": lambda names: from_parameters(names),
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


def from_parameters(names: list[str]) -> fjr.Robot:
    given = {"robot.model": "planar_two_link", "joints": names}
    return robot(complete(robot_parameters(given), given))


@pytest.mark.parametrize("entry", ENTRIES)
@given(names=BAD)
def test_bad_names_are_refused_in_one_printable_sentence(entry: str, names: list[str]) -> None:
    with pytest.raises(FjrError) as refused:
        ENTRIES[entry](names)
    assert str(refused.value).isprintable()
    assert re.search(r"(expected|; )", str(refused.value))


@given(
    names=st.tuples(NAMES, NAMES).filter(lambda pair: pair[0] != pair[1] and not {f"{n}_motor" for n in pair} & {*pair})
)
def test_other_names_are_accepted(names: tuple[str, str]) -> None:
    assert Settings(names).joints == names
    assert from_parameters(list(names)).n == 2


@pytest.mark.parametrize("tag", ["joint", "link"])
def test_a_urdf_with_a_name_that_cannot_be_printed_is_refused(tag: str) -> None:
    name = re.search(rf'<{tag} name="([^"]+)"', two_link_urdf())[1]
    text = two_link_urdf().replace(f'"{name}"', f'"{name}&#8238;"')
    with pytest.raises(FjrError, match="expected names of printable characters"):
        fjr.robot_from_urdf(text, ["shoulder", "elbow"], 400.0, 0.1)
