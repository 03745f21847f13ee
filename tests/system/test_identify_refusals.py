# SPDX-License-Identifier: Apache-2.0
"""`fjr identify` does not guess what a record cannot tell: robot.yaml keeps the prior and says which motion would."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fjr_core.config.scenario import load_scenario
from fjr_design.uncertainty.posterior import UNKNOWN, Estimate
from system.motion_tables import (
    PRIOR,
    MotionTable,
    one_joint,
    shoulder_at_rest,
    two_joints_without_gravity,
    without_gravity,
    without_resonance,
)

pytestmark = pytest.mark.system
K, B = (values[0] for values in PRIOR[1])


def judged(table: MotionTable, folder: Path, *more: str) -> tuple[dict[str, Estimate], str, str]:
    """Return the estimates by name, what the command says, and the text of robot.yaml."""
    found, said = table.identified(folder, *more)
    return {each.name: each for each in found.estimates}, said, (folder / "out/robot.yaml").read_text()


def test_a_joint_that_stands_still_keeps_all_guesses(tmp_path: Path) -> None:
    table = one_joint().of("link", "motor")
    random = np.random.default_rng(2)
    noise = {name: 1e-6 * random.standard_normal((400, 1)) for name in table.signals}
    still = MotionTable(table.joints, table.t[:400], noise, table.truth)
    found, said, text = judged(still, tmp_path, "--accept", "at_rest")
    assert {each.verdict for name, each in found.items() if name != "offset"} == {UNKNOWN}
    assert "motor_inertia of joint1: the joint stands still" in said
    assert f"joint_stiffness of joint1: {K:g} N m/rad, not identifiable from these records, as before" in text
    robot = load_scenario(tmp_path / "out/robot.yaml")
    assert (robot.robot.K[0, 0], robot.robot.M_m[0, 0]) == (K, B)
    assert len(robot.robot_warnings) == 2


def test_without_its_resonance_the_motor_side_leaves_the_stiffness_a_guess(tmp_path: Path) -> None:
    found, said, text = judged(without_resonance(), tmp_path)
    assert found["joint_stiffness"].verdict == UNKNOWN
    assert "without a link encoder only the resonance determines it; excite the joint near its resonance" in said
    assert f"joint_stiffness of joint1: {K:g} N m/rad, not identifiable" in text
    scenario = load_scenario(tmp_path / "out/robot.yaml")
    assert scenario.robot.K[0, 0] == K
    assert any("stiffness" in each for each in scenario.robot_warnings)


def test_without_gravity_the_motor_side_tells_the_stiffness_and_not_the_offset(tmp_path: Path) -> None:
    table = without_gravity()
    found, said, text = judged(table, tmp_path)
    assert found["offset"].verdict == UNKNOWN
    assert found["offset"].value == 0.0
    assert "offset of joint1: without a link encoder the offset shifts the link alone; measure the link" in said
    assert "offset of joint1" not in text  # it is listed where it is known only
    assert found["joint_stiffness"].value == pytest.approx(table.truth["joint_stiffness"][0], rel=0.01)


def of_joint(table: MotionTable, joint: str, folder: Path) -> dict[str, Estimate]:
    """Return the estimates of a joint by name; no interval is wrong, and what is not identifiable keeps its prior."""
    found, _ = table.identified(folder)
    for each in found.estimates:
        true = float(table.truth[each.name][table.joints.index(each.joint)])
        sd = (each.high - each.low) / 3.92
        assert each.verdict == UNKNOWN or abs(each.value - true) < max(4 * sd, 2e-3 * abs(true)), (each, true)
        assert each.verdict != UNKNOWN or each.value == each.prior
    return {each.name: each for each in found.estimates if each.joint == joint}


@pytest.mark.parametrize("signals", [("link", "motor"), ("motor", "torque")])
def test_a_joint_that_stands_still_beside_one_that_moves_is_not_guessed(
    tmp_path: Path, signals: tuple[str, ...]
) -> None:
    shoulder = of_joint(shoulder_at_rest().of(*signals), "shoulder", tmp_path)
    for name in ("motor_damping", "effort_delay", "torque_skew" if "torque" in signals else "link_skew"):
        assert shoulder[name].verdict == UNKNOWN
        assert "the joint stands still" in shoulder[name].reason


@pytest.mark.parametrize("signals", [("motor",), ("motor", "torque")])
def test_without_gravity_and_link_the_first_of_two_offsets_is_not_told(
    tmp_path: Path, signals: tuple[str, ...]
) -> None:
    shoulder = of_joint(two_joints_without_gravity().of(*signals), "shoulder", tmp_path)
    assert shoulder["offset"].verdict == UNKNOWN
    assert "measure the link" in shoulder["offset"].reason
    assert shoulder["joint_stiffness"].value == pytest.approx(220.0, rel=0.01)
