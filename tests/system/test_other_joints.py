# SPDX-License-Identifier: Apache-2.0
"""Arms with a prismatic joint, whose metrics are in m and N, and with springs that harden or soften."""

from __future__ import annotations

import itertools
import json
import re
import threading
from pathlib import Path

import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState

from fjr_core.config.controller import motion_limits, safety
from fjr_core.config.scenario import Scenario, load_scenario
from fjr_core.errors import ParameterError, TrajectoryError
from fjr_core.model.robot import PRISMATIC, REVOLUTE
from fjr_core.motions.motion_limits import check_motion
from fjr_core.motions.point_to_point import Hold
from fjr_core.runtime.control_step import ControlStep
from fjr_design.cli.check import check
from fjr_monitor.report.contact import AT_TIP, Contact, JointContact
from fjr_monitor.watch.state import Watched
from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.console.output import milli, number
from nodes.harness import Ros
from system.executables import fjr_here, fjr_json, sets
from tracking.tracked import sample
from watch_text import text

pytestmark = pytest.mark.system
URDF = """<robot name="lift_arm">
  <link name="base"/>
  <link name="carriage"><inertial><mass value="3.0"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="forearm"><inertial><origin xyz="0.1 0 0"/><mass value="1.0"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="9" effort="500"/></joint>
  <joint name="elbow" type="revolute"><parent link="carriage"/><child link="forearm"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="9" effort="20"/></joint>
</robot>
"""
SCENARIO = """/**:
  ros__parameters:
    start: {join_time: 0.0}
    joints: [lift, elbow]
    robot: {model: urdf, urdf: lift_arm.urdf, joint_stiffness: [4000.0, 300.0], motor_inertia: [1.0, 0.05],
            link_damping: [1.0, 0.1], motor_damping: [1.0, 0.1]}
/**/fjr_plant:
  ros__parameters: {initial_link_position: [0.05, 0.2], initial_motor_position: [0.05, 0.2]}
/**/fjr_controller:
  ros__parameters:
    reference: {amplitude: [0.0, 0.0]}
    gains: {Lambda_l: [8.0, 8.0], Pi_l: [200.0, 4.0], K_ld: [20.0, 0.5], Lambda_m: [8.0, 8.0],
            Pi_m: [4000.0, 300.0], K_md: [8.0, 0.5]}
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arm")
    (folder / "lift_arm.urdf").write_text(URDF)
    (folder / "arm.yaml").write_text(SCENARIO)
    return folder / "arm.yaml"


@pytest.fixture(scope="module")
def arm(file: Path) -> Scenario:
    return load_scenario(file)


@pytest.mark.usefixtures("no_picture")
def test_check_and_run_name_joint_and_unit_of_each_metric(file: Path, arm: Scenario, tmp_path: Path) -> None:
    assert arm.robot.units == (PRISMATIC, REVOLUTE)
    assert any("N, N m; within the effort limits" in text for text in check(arm).rows.values())
    run = ("run", str(file), "--lockstep", "--duration", "2.2", "--output", str(tmp_path))
    said = fjr_here(*run, codes=(Exit.DONE, Exit.VIOLATED))
    report = json.loads((tmp_path / "arm" / "report.json").read_text())
    (lift, elbow), tracking = report["joints"], report["tracking"]
    assert (lift["position_unit"], lift["effort_unit"]) == ("m", "N")
    assert (elbow["position_unit"], elbow["effort_unit"]) == ("rad", "N m")
    shares = {each["joint"]: each["peak_effort_nm"] / each["effort_limit_nm"] for each in (lift, elbow)}
    assert lift["peak_effort_nm"] > elbow["peak_effort_nm"]
    assert shares["elbow"] > shares["lift"]
    lifting = f"{number(lift['peak_effort_nm'], 'N', 4)} (lift)"
    assert f"{lifting}, {100 * shares['elbow']:.0f} % of its limit (elbow)" in said
    worst = {"lift": lift, "elbow": elbow}[tracking["max_error_after_2s_joint"]]
    error = f"{milli(worst['peak_error_after_2s_rad'], worst['position_unit'])} ({worst['joint']})"
    assert error in said
    page = (tmp_path / "arm" / "report.html").read_text()
    rms = [milli(each["rms_error_after_2s_rad"], each["position_unit"]) for each in (lift, elbow)]
    units = ("lift [mm, N]", "elbow [mrad, N m]", "[m, rad]", "[mm, mrad]", "[N, N m]")
    for shown in (" and ".join(rms), *units, "% of its limit (elbow)"):
        assert shown in page, shown


def test_limits_of_a_prismatic_joint_are_in_metres(arm: Scenario) -> None:
    values = {**arm.controller_values, "limits.link_position_upper": [0.04, 0.1], "limits.link_velocity": [1.0, 1.0]}
    tracker = ControlStep(arm.law, Hold((0.0, 0.0)), safety(values, arm.robot))
    tracker.command(sample(0, (0.05, 0.2), 0.0), 0)
    assert tracker.reason == "stopped: link position of lift: q_l = 0.05 m; expected at most 0.04 m"
    tracker.start()
    tracker.command(sample(0, 0.0, 0.0, (2.0, 0.0)), 0)
    assert "dq_l = 2 m/s; expected at most 1 m/s" in tracker.reason
    beneath = {"limits.link_position_lower": [-1.0, -1.0], "limits.link_position_upper": [-2.0, 0.0]}
    with pytest.raises(ParameterError, match="of lift is -2 m; expected at least .*, -1 m"):
        safety({**values, **beneath}, arm.robot)
    with pytest.raises(TrajectoryError, match="joint 'lift' would reach 0.5 m at 0 s; its limit is 0.04 m"):
        check_motion(Hold((0.5, 0.0)), motion_limits(safety(values, arm.robot), arm.robot), joints=arm.joints)


def test_a_new_robot_file_and_its_summary_have_the_units_of_each_kind_of_joint(file: Path, tmp_path: Path) -> None:
    said = fjr_here("new", str(file.with_name("lift_arm.urdf")), "--output", str(tmp_path))
    stiffness, inertia = (next(line for line in said.splitlines() if line.startswith(name)) for name in ("sti", "ine"))
    assert re.search(r"\d N/m and .*\d N m/rad; GUESS$", stiffness)
    assert re.search(r"\d kg and .*\d kg m\^2 of the motors; GUESS$", inertia)
    written = (tmp_path / "lift_arm_robot.yaml").read_text()
    assert "# K [N/m, N m/rad]; GUESS" in written
    assert "[kg, kg m^2]; GUESS" in written


def test_bound_and_contact_name_the_efforts_of_each_kind_of_joint(file: Path) -> None:
    bound = fjr_here("check", str(file), "--error", "link_torque=0.1", codes=(Exit.DONE, Exit.FAILED))
    assert "with link torques of up to 0.1 N, N m, no delay" in bound
    touched = [JointContact("lift", "N", 30.0, None), JointContact("elbow", "N m", 2.0, None)]
    assert "external torque on lift 30 N, elbow 2 N m" in Contact(1.0, 2.0, touched, None, AT_TIP, None).sentence


def test_a_sweep_a_tuning_and_a_comparison_of_prismatic_joints_are_in_mm_and_newtons(
    file: Path, tmp_path: Path
) -> None:
    lift = URDF.replace('type="revolute"', 'type="prismatic"')
    (tmp_path / "lift_arm.urdf").write_text(lift)
    (tmp_path / "arm.yaml").write_text(file.read_text())
    options = (str(tmp_path / "arm.yaml"), "--duration", "1.5", "--cores", "1", "--output", str(tmp_path))
    swept = fjr_here("sweep", *options, "--runs", "8")
    assert re.search(r"rms +[\d.]+ mm", swept)
    assert re.search(r"effort_peak +[\d.]+ N ", swept)
    limits = (tmp_path / "arm" / "report.html").read_text()
    assert "unstable: beyond 0.3 m<" in limits
    tuned = fjr_here("tune", *options, "--candidates", "4", "--draws", "4", "--fresh", "8")
    assert re.search(r"RMS error, median +[\d.]+ mm", tuned)
    page = (tmp_path / "arm" / "report.html").read_text()
    moved = {"scenario": str(tmp_path / "arm.yaml"), "references": {"slow": {"reference.amplitude": [0.05, 0.05]}}}
    suite = {"laws": ["v_dpbc"], "robots": {"lifts": moved}, "margins": ["noise"], "duration": 3.0, "tracks": 0.5}
    (tmp_path / "lifts.yaml").write_text(json.dumps(suite))
    compared = fjr_here("compare", str(tmp_path / "lifts.yaml"), "--output", str(tmp_path))
    assert re.search(r"noise up to +[\d.]+ mm", compared)
    assert "RMS error [mm]" in compared
    beside = (tmp_path / "compare_lifts" / "comparison.html").read_text()
    assert all(words in beside for words in ("noise of the positions [mm]", "|u| [N]", "Errors in mm;"))
    for said in (swept, tuned, page, limits, compared, beside):
        assert not re.search(r"\d m?rad\b|\[m?rad\]|N m\b", said)


def test_the_live_view_marks_a_prismatic_joint() -> None:
    watched = Watched("live")
    watched.description(URDF)
    watched.state(0.0, {"lift": 0.1, "elbow": 0.2}, {})
    shown = text(watched.view(0.0))
    assert "lift [m, mm, N]" in shown
    assert "elbow [" not in shown


def test_the_live_view_of_a_named_scenario_marks_it_without_a_robot_description(file: Path) -> None:
    ended = threading.Event()
    with Ros() as ros:
        publisher = ros.add(Node("driver", context=ros.context)).create_publisher(JointState, "/joint_states", 10)

        def publish() -> None:
            for k in itertools.count():
                message = JointState(name=["lift", "elbow"], position=[0.1, 0.2])
                message.header.stamp.nanosec = k
                publisher.publish(message)
                if ended.wait(0.01):
                    return

        driver = threading.Thread(target=publish)
        driver.start()
        try:
            shown = fjr_here("watch", str(file), "--once", "--timeout", "2")
        finally:
            ended.set()
            driver.join()
    assert "lift [m, mm, N]" in shown
    assert "elbow [" not in shown


HARD = ("two_link", "--set", "robot.cubic_stiffness:=[4.0e3, 2.5e3]")  # twice the torque at 0.1 rad

AT = {"position": "[0.3, 0.0]", "velocity": "[1.0, 2.1]"}  # the reference's start
NEAR = sets(*(f"initial_link_{name}:={value}" for name, value in AT.items()))
NEAR += sets("initial_motor_position:=[0.34, 0.01]", "initial_motor_velocity:=[1.0, 2.1]")


def test_check_has_the_rate_of_straight_springs_the_tangents_and_warns_of_a_start_that_diverges() -> None:
    """The shipped start is 0.3 rad off; a start on the reference tracks."""
    far, straight, near = (fjr_json("check", *each) for each in (HARD, HARD[:1], (*HARD, *NEAR)))
    assert far["beta_per_s"] == straight["beta_per_s"]
    assert far["beta_is_proven"]
    assert far["stable"]
    assert "stiffer at rest on the reference" in far["rows"]["springs"]
    assert "springs" not in straight["rows"]
    assert far["spectral_radius"] != straight["spectral_radius"]
    assert any("diverges as sampled from the start error [-0.3, 0] rad" in each for each in far["warnings"])
    assert "diverges as sampled" in far["rows"]["start error"]
    assert not any("diverges" in each for each in near["warnings"])
    assert near["rows"]["start error"].startswith("springs deflect up to")
    assert near["rows"]["start error"].endswith("with springs as stiff as there")


POINTS = ("robot.torsion_deflection:=[0.02, 0.02, 0.05, 0.05]", "robot.torsion_torque:=[0.9, 0.4, 2.8, 0.9]")
TABLE = ("two_link", *sets(*POINTS))  # the second joint softens


@pytest.mark.parametrize("springs", [HARD, pytest.param(TABLE, marks=pytest.mark.full)], ids=["cubic", "table"])
def test_a_run_keeps_the_certificate_and_no_wiring_fault_is_seen(tmp_path: Path, springs: tuple[str, ...]) -> None:
    options = ("--lockstep", "--no-report", "--duration", "1.5", "--output", str(tmp_path))
    said = fjr_here("run", *springs, *NEAR, *options)
    assert re.search(r"^two_link \(lock-step\) .*holding$", said, re.MULTILINE), said


def test_check_says_which_springs_of_a_table_are_stiffer_and_which_softer() -> None:
    found = fjr_json("check", *TABLE)
    assert found["stable"]
    softer, stiffer = (
        [float(each) for each in part.split("[")[1].split("]")[0].split(",")]
        for part in found["rows"]["springs"].split("% softer")
    )
    assert softer[1] > 1 > softer[0]
    assert stiffer[0] > 1 > stiffer[1]
