# SPDX-License-Identifier: Apache-2.0
"""Trees of URDFs: poses of sliding and mimic joints, and serial chains."""

from __future__ import annotations

import numpy as np
import pytest

from core.oracles.cases import Array
from fjr_core.urdf.tree import read_urdf
from fjr_design.scaffold.arm import chains

MIMIC = """<robot name="hand"><link name="palm"/><link name="a"/><link name="b"/>
<joint name="one" type="prismatic"><parent link="palm"/><child link="a"/><axis xyz="0 2 0"/>
  <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="two" type="continuous"><parent link="palm"/><child link="b"/><axis xyz="0 0 1"/>
  <mimic joint="one" multiplier="-2" offset="0.5"/></joint></robot>"""


def placed(xml: str, positions: dict[str, float]) -> dict[str, Array]:
    """Return the homogeneous placement of each link in the root, by composing the poses of the joints."""
    tree = read_urdf(xml)
    above = {joint.child: joint for joint in tree.joints.values()}

    def placement(link: str) -> Array:
        if link not in above:
            return np.eye(4)
        return placement(above[link].parent) @ above[link].pose(tree.position(above[link], positions))

    return {link: placement(link) for link in above}


def test_a_sliding_joint_moves_along_its_unit_axis_and_a_mimic_joint_follows() -> None:
    links = placed(MIMIC, {"one": 0.25})
    np.testing.assert_allclose(links["a"][:3], [[0, -1, 0, -0.25], [1, 0, 0, 0], [0, 0, 1, 1]], atol=1e-15)
    np.testing.assert_allclose(links["b"], np.eye(4), atol=1e-15)  # -2 * 0.25 + 0.5 = 0


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


FIVE: tuple[Joint, ...] = tuple((f"j{i}", f"l{i - 1}", f"l{i}") for i in range(1, 6))
NAMES = tuple(f"j{i}" for i in range(1, 6))


def found(text: str) -> list[tuple[str, ...]]:
    return chains(read_urdf(text))


@pytest.mark.parametrize("name", ["left_finger", "gripper_joint", "Jaw", "hand_index_1", "thumb", "jointGripper"])
def test_a_chain_ends_before_a_joint_named_like_a_gripper(name: str) -> None:
    assert found(urdf(*FIVE, (name, "l5", "l6"))) == [NAMES]


@pytest.mark.parametrize("fingers", [2, 3])
def test_a_chain_ends_where_it_branches_into_fingers(fingers: int) -> None:
    sides = [(f"side{i}_{k}", f"tip{i}_{k - 1}" if k else "l5", f"tip{i}_{k}") for i in range(fingers) for k in (0, 1)]
    assert found(urdf(*FIVE, *sides)) == [NAMES]


def test_a_chain_crosses_fixed_joints_and_a_mimicking_finger_makes_its_leader_a_finger() -> None:
    assert found(urdf(*FIVE, kinds={"j3": "fixed"})) == [("j1", "j2", "j4", "j5")]
    two = (("left", "l5", "a"), ("right", "l5", "b"))
    assert found(urdf(*FIVE, *two, inner={"right": '<mimic joint="left"/>'})) == [NAMES]


def test_two_arms_on_a_torso_are_two_chains_with_the_torso() -> None:
    arms = [
        (f"{side}{i}", f"{side}link{i - 1}" if i > 1 else "chest", f"{side}link{i}")
        for side in "ab"
        for i in range(1, 7)
    ]
    longest = found(urdf(("torso", "base", "chest"), *arms))
    assert longest == [("torso", *(f"{side}{i}" for i in range(1, 7))) for side in "ab"]


def test_the_longest_chain_is_first_and_neither_wheels_nor_a_gripper_alone_are_chains() -> None:
    more = (("neck", "l0", "head"), ("left_wheel_joint", "l0", "wheel"))
    assert found(urdf(*more, *FIVE, kinds={"left_wheel_joint": "continuous"})) == [NAMES, ("neck",)]

    assert found(urdf(("left_finger", "palm", "a"), ("right_finger", "palm", "b"))) == []
