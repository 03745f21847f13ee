# SPDX-License-Identifier: Apache-2.0
"""`fjr identify` with each kind of measurement finds the parameters of records that other code made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fjr_core.config.scenario import load_scenario
from fjr_design.uncertainty.posterior import UNKNOWN, Identification
from system.executables import fjr_here
from system.motion_tables import MotionTable, one_joint, two_joints
from system.shared_runs import shared_run

pytestmark = pytest.mark.system
KINDS = {
    "both sides": ("link", "motor"),
    "motor side only": ("motor",),
    "torque sensor and motor": ("motor", "torque"),
    "torque sensor and link": ("link", "torque"),
}
EXACT = 2e-3  # error of numbers that the noise of these records would permit to be smaller
TABLES = {"one joint": one_joint, "two joints": two_joints}


def agrees(found: Identification, table: MotionTable) -> None:
    """Check each estimate against the truth, and that the stiffness and the rotor inertia are known."""
    for each in found.estimates:
        true = float(table.truth[each.name][table.joints.index(each.joint)])
        if each.verdict == UNKNOWN:
            assert each.value == each.prior, each
            assert each.name not in ("joint_stiffness", "motor_inertia"), each
            continue
        sd = (each.high - each.low) / 3.92
        assert abs(each.value - true) < max(4 * sd, EXACT * abs(true)), (each, true)
        if each.name in ("joint_stiffness", "motor_inertia"):
            assert each.value == pytest.approx(true, rel=0.01), each


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("arm", TABLES)
def test_each_kind_of_measurement_tells_the_joints_in_encoder_steps(tmp_path: Path, arm: str, kind: str) -> None:
    table = TABLES[arm]().of(*KINDS[kind])
    found, _ = table.identified(tmp_path)
    agrees(found, table)
    names = {each.name for each in found.estimates}
    assert ("link_skew" in names) == ({"link", "motor"} <= set(KINDS[kind]))
    assert ("torque_skew" in names) == ("torque" in KINDS[kind])
    unknown = {each.reason for each in found.estimates if each.name == "offset" and each.verdict == UNKNOWN}
    assert any("measure the motor" in reason for reason in unknown) == ("motor" not in KINDS[kind])
    scenario = load_scenario(tmp_path / "out/robot.yaml")
    assert scenario.robot_warnings == ()
    assert np.diag(scenario.robot.K) == pytest.approx(table.truth["joint_stiffness"], rel=0.01)


def test_a_bag_with_torque_sensors_in_place_of_motor_positions_tells_the_joint(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    arguments = one_joint().written(tmp_path)
    arguments[1] = str(shared_run(tmp_path_factory, "paper_k31"))
    (tmp_path / "map.yaml").write_text("bag: {motor: torque}\n")
    fjr_here(*arguments)
    robot = load_scenario(tmp_path / "out/robot.yaml").robot
    assert robot.K[0, 0] == pytest.approx(31.0, rel=0.01)
    assert robot.M_m[0, 0] == pytest.approx(0.004, rel=0.01)
