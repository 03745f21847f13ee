# SPDX-License-Identifier: Apache-2.0
"""Transforms between the links of a URDF agree with Pinocchio's placements; mimic joints follow their joint."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from core.oracles.cases import Array
from core.oracles.chains import ARM7, ARM7_JOINTS, random_urdf
from fjr_core.errors import RobotError
from fjr_core.urdf.tree import UrdfFrames

MIMIC = """<robot name="hand"><link name="palm"/><link name="a"/><link name="b"/>
<joint name="one" type="prismatic"><parent link="palm"/><child link="a"/><axis xyz="0 2 0"/>
  <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="two" type="continuous"><parent link="palm"/><child link="b"/><axis xyz="0 0 1"/>
  <mimic joint="one" multiplier="-2" offset="0.5"/></joint></robot>"""


def placed(frames: UrdfFrames, positions: dict[str, float]) -> dict[str, Array]:
    """Return the homogeneous placement of each link in the root, by composing the transforms."""
    relative = {each.child: each for each in frames.at(positions)}

    def placement(link: str) -> Array:
        if link not in relative:
            return np.eye(4)
        each = relative[link]
        here = pin.SE3(pin.Quaternion(np.array(each.quaternion)).matrix(), np.array(each.translation))
        return placement(each.parent) @ here.homogeneous

    return {link: placement(link) for link in relative}


def agree(xml: str, positions: dict[str, float]) -> None:
    model = pin.buildModelFromXML(xml)
    data, q = model.createData(), pin.neutral(model)
    for name, value in positions.items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
    pin.framesForwardKinematics(model, data, q)
    links = placed(UrdfFrames(xml), positions)
    assert links
    for link, found in links.items():
        expected = data.oMf[model.getFrameId(link, pin.FrameType.BODY)].homogeneous
        np.testing.assert_allclose(found, expected, atol=1e-12, err_msg=link)


@pytest.mark.parametrize("seed", range(3))
def test_random_arms_agree_with_pinocchio(seed: int) -> None:
    case = random_urdf(5, seed)
    names = list(pin.buildModelFromXML(case.xml).names)[1:]
    agree(case.xml, dict(zip(names, np.random.default_rng(seed).uniform(-2, 2, len(names)), strict=True)))


def test_seven_joint_arm_agrees_with_pinocchio() -> None:
    agree(ARM7.read_text(), dict(zip(ARM7_JOINTS, np.linspace(-1.0, 1.0, 7), strict=True)))


def test_unknown_joints_are_ignored_and_missing_ones_are_at_zero() -> None:
    frames = UrdfFrames(ARM7.read_text())
    np.testing.assert_array_equal(
        [each.quaternion for each in frames.at({"joint1_motor": 1.0})], [each.quaternion for each in frames.at({})]
    )


def test_a_sliding_joint_moves_along_its_unit_axis_and_a_mimic_joint_follows() -> None:
    slide, turn = UrdfFrames(MIMIC).at({"one": 0.25})
    np.testing.assert_allclose(slide.translation, [-0.25, 0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(slide.quaternion, [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    assert (turn.parent, turn.child) == ("palm", "b")
    np.testing.assert_allclose(turn.quaternion, [0.0, 0.0, 0.0, 1.0], atol=1e-15)  # -2 * 0.25 + 0.5 = 0


def test_invalid_text_is_refused() -> None:
    with pytest.raises(RobotError, match="does not parse as XML"):
        UrdfFrames("<robot")
