# SPDX-License-Identifier: Apache-2.0
"""`fjr identify` with each kind of measurement finds the parameters of records that other code made.

What a record cannot reveal is not guessed: robot.yaml keeps the prior and says which motion would reveal it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fjr_core.config.scenario import load_scenario
from fjr_design.uncertainty.posterior import UNKNOWN, Estimate
from system.executables import fjr_here
from system.motion_tables import PRIOR, MotionTable, one_joint, shoulder_at_rest, two_joints
from system.shared_runs import shared_run

pytestmark = pytest.mark.system
KINDS = {
    "both sides": ("link", "motor"),
    "motor side only": ("motor",),
    "torque sensor and motor": ("motor", "torque"),
    "torque sensor and link": ("link", "torque"),
}
EXACT = 2e-3  # error of numbers that the noise of these records would permit to be smaller


def agreeing(table: MotionTable, folder: Path, *options: str) -> tuple[Estimate, ...]:
    """Return the estimates; no interval is wrong, and what is not identifiable keeps its prior."""
    found, _ = table.identified(folder, *options)
    for estimate in found.estimates:
        true = float(table.truth[estimate.name][table.joints.index(estimate.joint)])
        sd = (estimate.high - estimate.low) / 3.92
        right = abs(estimate.value - true) < max(4 * sd, EXACT * abs(true))
        assert estimate.value == estimate.prior if estimate.verdict == UNKNOWN else right, (estimate, true)
    return found.estimates


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_measurement_reveals_the_joints_in_encoder_steps(tmp_path: Path, kind: str) -> None:
    table = two_joints().of(*KINDS[kind])
    estimates = agreeing(table, tmp_path)
    for name in ("joint_stiffness", "motor_inertia"):
        assert [e.value for e in estimates if e.name == name] == pytest.approx(table.truth[name], rel=0.01)
        assert UNKNOWN not in [e.verdict for e in estimates if e.name == name]
    names = {estimate.name for estimate in estimates}
    assert ("link_skew" in names) == ({"link", "motor"} <= set(KINDS[kind]))
    assert ("torque_skew" in names) == ("torque" in KINDS[kind])
    unknown = {estimate.reason for estimate in estimates if estimate.name == "offset" and estimate.verdict == UNKNOWN}
    assert any("measure the motor" in reason for reason in unknown) == ("motor" not in KINDS[kind])
    scenario = load_scenario(tmp_path / "out/robot.yaml")
    assert scenario.robot_warnings == ()
    assert np.diag(scenario.robot.K) == pytest.approx(table.truth["joint_stiffness"], rel=0.01)


def test_a_bag_with_torque_sensors_in_place_of_motor_positions_reveals_the_joint(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    arguments = one_joint().written(tmp_path)
    arguments[1] = str(shared_run(tmp_path_factory, "paper_k31"))
    (tmp_path / "map.yaml").write_text("bag: {motor: torque}\n")
    fjr_here(*arguments)
    robot = load_scenario(tmp_path / "out/robot.yaml").robot
    assert robot.K[0, 0] == pytest.approx(31.0, rel=0.01)
    assert robot.M_m[0, 0] == pytest.approx(0.004, rel=0.01)


def test_a_joint_that_stands_still_keeps_all_guesses(tmp_path: Path) -> None:
    (K,), (B,) = PRIOR[1]
    table = one_joint().of("link", "motor")
    random = np.random.default_rng(2)
    noise = {name: 1e-6 * random.standard_normal((400, 1)) for name in table.signals}
    still = MotionTable(table.joints, table.t[:400], noise, table.truth)
    found, said = still.identified(tmp_path, "--accept", "at_rest")
    assert {e.verdict for e in found.estimates if e.name != "offset"} == {UNKNOWN}
    (why,) = [line for line in said.splitlines() if "the joint stands still" in line]
    assert why.startswith("motor_inertia, link_damping, motor_damping, ")
    text = (tmp_path / "out/robot.yaml").read_text()
    assert f"joint_stiffness of joint1: {K:g} N m/rad, not identifiable from these records, kept as given" in text
    robot = load_scenario(tmp_path / "out/robot.yaml")
    assert (robot.robot.K[0, 0], robot.robot.M_m[0, 0]) == (K, B)
    assert len(robot.robot_warnings) == 2


@pytest.mark.parametrize("other", ["link", pytest.param("torque", marks=pytest.mark.full)])
def test_a_shoulder_that_stands_still_beside_a_moving_elbow_keeps_its_guesses(tmp_path: Path, other: str) -> None:
    """Without gravity, which tells the offset of the first joint: identification/estimation/test_identify.py."""
    table = shoulder_at_rest().of(other, "motor")
    shoulder = {each.name: each for each in agreeing(table, tmp_path, "--joints", "shoulder")}
    for name in ("motor_damping", "effort_delay", f"{other}_skew"):
        assert shoulder[name].verdict == UNKNOWN
        assert "the joint stands still" in shoulder[name].reason
