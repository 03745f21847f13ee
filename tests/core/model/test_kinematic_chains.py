# SPDX-License-Identifier: Apache-2.0
"""Chains of a URDF: the longest first, without grippers, hands and wheels."""

from __future__ import annotations

import pytest

from fjr_core.urdf.chains import chains
from fjr_core.urdf.tree import read_urdf

Joint = tuple[str, str, str]


def urdf(*joints: Joint, kinds: dict[str, str] | None = None, inner: dict[str, str] | None = None) -> str:
    """Return a URDF of joints (name, parent, child), revolute unless `kinds` has another type."""
    links = dict.fromkeys(link for _, parent, child in joints for link in (parent, child))
    parts = [f'<link name="{link}"/>' for link in links]
    for name, parent, child in joints:
        kind, more = (kinds or {}).get(name, "revolute"), (inner or {}).get(name, "")
        parts.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'
        )
    return f'<robot name="r">{"".join(parts)}</robot>'


ARM: tuple[Joint, ...] = tuple((f"j{i}", f"l{i - 1}", f"l{i}") for i in range(1, 6))
NAMES = tuple(f"j{i}" for i in range(1, 6))


def found(text: str) -> list[tuple[str, ...]]:
    return [chain.joints for chain in chains(read_urdf(text))]


def test_a_chain_runs_from_the_base_to_the_tip_across_fixed_joints() -> None:
    assert found(urdf(*ARM, kinds={"j3": "fixed"})) == [("j1", "j2", "j4", "j5")]


@pytest.mark.parametrize("name", ["left_finger", "gripper_joint", "Jaw", "hand_index_1", "thumb", "jointGripper"])
def test_a_chain_ends_before_a_joint_named_like_a_gripper(name: str) -> None:
    assert found(urdf(*ARM, (name, "l5", "l6"))) == [NAMES]


@pytest.mark.parametrize("fingers", [2, 3])
def test_a_chain_ends_where_it_branches_into_fingers(fingers: int) -> None:
    sides = [(f"side{i}_{k}", f"tip{i}_{k - 1}" if k else "l5", f"tip{i}_{k}") for i in range(fingers) for k in (0, 1)]
    assert found(urdf(*ARM, *sides)) == [NAMES]


def test_a_mimicking_finger_makes_its_leader_a_finger() -> None:
    two = (("left", "l5", "a"), ("right", "l5", "b"))
    assert found(urdf(*ARM, *two, inner={"right": '<mimic joint="left"/>'})) == [NAMES]


def test_two_arms_on_a_torso_are_two_chains_with_the_torso() -> None:
    arms = [
        (f"{side}{i}", f"{side}link{i - 1}" if i > 1 else "chest", f"{side}link{i}")
        for side in "ab"
        for i in range(1, 7)
    ]
    longest = found(urdf(("torso", "base", "chest"), *arms))
    assert longest == [("torso", *(f"{side}{i}" for i in range(1, 7))) for side in "ab"]


def test_the_longest_chain_is_first_and_wheels_are_none() -> None:
    more = (("neck", "l0", "head"), ("left_wheel_joint", "l0", "wheel"))
    assert found(urdf(*more, *ARM, kinds={"left_wheel_joint": "continuous"})) == [NAMES, ("neck",)]


def test_a_gripper_alone_has_no_chain() -> None:
    assert found(urdf(("left_finger", "palm", "a"), ("right_finger", "palm", "b"))) == []
