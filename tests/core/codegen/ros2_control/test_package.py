# SPDX-License-Identifier: Apache-2.0
"""The exported package: the step gives Python's efforts bit by bit, controller and arm run against stand-ins."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

import fjr_core as fjr
import own_code
from core.codegen.c_program import SHIPPED, program_output
from core.codegen.ros2_control.exported_package import driver, exported, replayed, scenario, values
from fjr_core.codegen.ros2_control import export_package, package_name_of
from fjr_core.codegen.step_code import controller_of
from fjr_core.config import builders
from fjr_core.config.scenario import parse_scenario
from fjr_core.control_step.event_kinds import ERRORS, KINDS, WARNINGS
from fjr_core.control_step.library import HEADER, text

PACKAGE = "two_link_ros2_control"
MORE = {
    "observer": "{measurement.velocity: observer, limits.effort: [20.0]}",
    "torque": "{measurement.velocity: observer, measurement.motor: torque}",
    "robust": "{robust.residual_gain: [20.0], robust.integral_gain: [2.0], robust.delay: 0.001, robust.hold: 0.001}",
    "transition": "{start.join_time: 0.1, start.ramp_time: 0.05, limits.effort_rate: [500.0], on_stop: gravity_hold}",
    "geared": "{measurement.gear_ratio: [-100.0]}",
}
"""Parameters of scenarios by name that use other parts of the step."""


@pytest.mark.parametrize("name", SHIPPED)
def test_step_of_every_shipped_scenario_gives_the_efforts_of_python(name: str, tmp_path: Path) -> None:
    assert replayed(exported(scenario(name), tmp_path), package_name_of(name)) == (200, 0)


@pytest.mark.parametrize("name", MORE)
def test_step_gives_the_efforts_of_python_with(name: str, tmp_path: Path) -> None:
    made = parse_scenario(name, f"/**: {{ros__parameters: {MORE[name]}}}")
    assert replayed(exported(made, tmp_path), package_name_of(name)) == (200, 0)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the driver of controller and arm of two_link."""
    return driver(exported(scenario("two_link"), tmp_path_factory.mktemp("package") / "p"), PACKAGE)


@pytest.fixture(scope="module")
def tracked(drive: Path) -> dict[str, float]:
    return values(program_output(drive, "track"))


@pytest.mark.parametrize(
    "imperfections", [[], ["link_position_noise=1e-5", "command_delay=0.0005", "motor_encoder_bits=18"]]
)
def test_efforts_of_the_controller_equal_those_of_python(drive: Path, imperfections: list[str]) -> None:
    n, step = 2, controller_of(scenario("two_link")).step()
    for line in program_output(drive, "record", *imperfections).splitlines():
        row = np.array([float.fromhex(word) for word in line.split()])
        link, motor, dq_l, dq_m, stamp, u = np.split(row, [n, 2 * n, 3 * n, 4 * n, 4 * n + 1])
        assert step.step(int(stamp[0]), int(stamp[0]), link, motor, dq_l, dq_m)
        assert np.array_equal(step.u, u)


def test_controller_without_velocities_and_certificate_gives_the_efforts_of_python(tmp_path: Path) -> None:
    parameters = (
        "{law.type: pd_gravity, measurement.velocity: observer, measurement.motor: torque, on_stop: gravity_hold}"
    )
    made = parse_scenario("torque", f"/**: {{ros__parameters: {parameters}}}")
    program, step = driver(exported(made, tmp_path / "p"), "torque_ros2_control"), controller_of(made).step()
    for line in program_output(program, "record").splitlines():
        link, torque, stamp, u = (float.fromhex(word) for word in line.split())
        assert step.step(int(stamp), int(stamp), np.array([link]), np.array([torque]), None, None)
        assert step.u == u


def test_tracks_as_the_simulation_in_python(tracked: dict[str, float]) -> None:
    run = scenario("two_link").simulate(6.0)
    late = run.t > 3.0
    expected = np.abs(run.x[late, :2] - run.jets[late, 0]).max()
    assert tracked["worst_error"] == pytest.approx(expected, rel=0.05)
    assert tracked["state"] == 2


def test_certificate_is_published_and_equals_python(drive: Path, tracked: dict[str, float]) -> None:
    assert tracked["certificates"] == 600
    values = [tracked[f"certificate_{i}"] for i in range(9)]
    V, bound, H = values[2], values[5], values[6]
    run = scenario("two_link").simulate(6.0)
    k = round((values[0] + values[1] * 1e-9) * 1000)
    assert pytest.approx(run.V[k], rel=0.2) == V
    assert H > 0
    assert 0 <= bound < V  # the bound of continuous time


def test_controller_and_arm_allocate_no_memory_while_they_run(drive: Path) -> None:
    assert values(program_output(drive, "allocate", "command_delay=0.002", "limits.effort=1 1"))["allocations"] == 0


def test_deactivation_in_motion_sends_the_stop_effort_and_tracking_starts_again(drive: Path) -> None:
    found = values(program_output(drive, "restart"))
    assert abs(found["speed_before"]) > 0.1
    assert [found["stop_effort_0"], found["stop_effort_1"]] == [0, 0]
    assert found["state"] == found["state_after_restart"] == 2


def test_inactive_arm_is_held_by_its_brakes(drive: Path) -> None:
    found = values(program_output(drive, "restart"))
    assert found["moved_while_inactive"] == found["speed_while_inactive"] == 0


def test_missing_states_hold_the_effort_until_the_timeout(drive: Path) -> None:
    output = program_output(drive, "silence")
    found = values(output)
    assert found["held"] == found["after_timeout"] == 0
    assert "events silences;recoveries;" in output


def test_violated_limit_stops_and_is_reported(drive: Path) -> None:
    output = program_output(drive, "stop", "limits.link_velocity=0.3 0.3")
    found = values(output)
    assert (found["state"], found["stops"], found["effort"]) == (3, 1, 0)
    assert re.search(r"stops: link velocity, (shoulder|elbow): -?0\.3\d+; expected at (most|least) -?0\.3", output)
    assert "events stops;" in output


def test_value_that_is_not_finite_is_no_sample_and_the_effort_stays(drive: Path) -> None:
    found = values(program_output(drive, "not_finite"))
    assert (found["update"], found["change"]) == (1, 0)
    assert found["effort"] != 0


def test_reference_interfaces_lead_the_arm(drive: Path) -> None:
    output = program_output(drive, "chained")
    found = values(output)
    assert abs(found["held"]) < 1e-3
    assert found["worst_error"] < 2e-4
    assert "first_reference tracking_controller/shoulder/position" in output


def test_effort_limits_of_the_parameters_hold(drive: Path) -> None:
    lines = program_output(drive, "record", "limits.effort=0.5 0.25").splitlines()
    efforts = np.array([[float.fromhex(word) for word in line.split()[-2:]] for line in lines])
    assert np.array_equal(np.abs(efforts).max(axis=0), [0.5, 0.25])


def test_gains_of_the_parameters_replace_those_of_the_scenario(drive: Path) -> None:
    lines = program_output(drive, "record", "gains.K_md=0.5 0.25", "gains.Pi_m=80 40").splitlines()
    row = np.array([float.fromhex(word) for word in lines[7].split()])
    given = scenario("two_link")
    gains = {"gains.K_md": (0.5, 0.25), "gains.Pi_m": (80.0, 40.0)}
    law = fjr.TrackingLaw(given.robot, builders.gains({**given.controller_values, **gains}, 2))
    u, _ = law.measured_command(row[:4], row[4:8], given.reference.jets(row[8] * 1e-9))
    assert row[9:] == pytest.approx(u, rel=1e-12)


def test_configures_with_valid_parameters_at_the_exported_rate_only(drive: Path) -> None:
    output = program_output(drive, "configure")
    found = values(output)
    assert [found[f"configures_at_{rate}"] for rate in (0, 500, 1000)] == [0, 0, 1]
    assert found["short_list"] == found["negative_limit"] == found["unknown_policy"] == 0
    assert "parameter 'limits.effort' is 1 numbers; expected 2" in output
    assert "parameter 'on_stop' is brake; expected zero or gravity_hold" in output


@pytest.mark.parametrize(
    "parameter", ["actuator_lag=-1", "actuator_lag=1 2 3", "actuator_lag=x", "time=now", "seed=", "payload=1"]
)
def test_arm_refuses_invalid_parameters_in_one_sentence(drive: Path, parameter: str) -> None:
    name = parameter.split("=")[0]
    assert f"parameter '{name}' is " in program_output(drive, "record", parameter, code=2)


def test_imperfections_change_the_motion(drive: Path) -> None:
    def record(*parameters: str) -> str:
        return program_output(drive, "record", *parameters)

    ideal = record()
    assert record() == ideal
    for parameter in ("link_coulomb_friction=0.1", "actuator_lag=0.002", "command_delay=0.002", "state_delay=0.001"):
        assert record(parameter) != ideal
    noisy = "link_position_noise=1e-4"
    assert record(noisy) == record(noisy) != record(noisy, "seed=3")
    assert record("effort_limit=inf") == ideal


def test_urdf_holds_every_interface_that_the_controller_claims() -> None:
    texts = export_package(scenario("two_link"), PACKAGE, 1)
    robot = ElementTree.fromstring(texts[f"urdf/{PACKAGE}.urdf"])
    (system,) = robot.findall("ros2_control")
    assert system.findtext("hardware/plugin") == f"{PACKAGE}/ElasticArm"
    found = {f"{c.get('name')}/{i.get('name')}" for c in system for i in c.findall("state_interface")}
    efforts = {f"{c.get('name')}/{i.get('name')}" for c in system for i in c.findall("command_interface")}
    parameters = yaml.safe_load(texts["config/controllers.yaml"])["tracking_controller"]["ros__parameters"]
    sides = [*parameters["joints"], *parameters["motors"]]
    assert {f"{side}/{kind}" for side in sides for kind in ("position", "velocity")} <= found
    assert parameters["stamp_interface"] in found
    assert efforts == {f"{joint}/effort" for joint in parameters["command_joints"]}
    joints = {joint.get("name") for joint in robot.findall("joint")}
    assert {joint.get("name") for joint in system.findall("joint")} <= joints


def test_event_kinds_are_those_of_the_step_in_order() -> None:
    body = re.search(r"enum fjr_kind \{(.*?)\}", text(HEADER), re.DOTALL)
    assert body is not None
    names = [name.removeprefix("FJR_").lower().replace("_", " ") for name in re.findall(r"FJR_\w+", body[1])][:-1]
    kinds = [kind.replace(":", "").removesuffix(" than the last") for kind in KINDS]
    assert names == kinds
    assert {*ERRORS, *WARNINGS} <= set(KINDS)


@pytest.mark.parametrize(
    ("scenario", "package"),
    [("arm-7 B", "arm_7_b_ros2_control"), ("7", "robot_7_ros2_control"), ("ä", "robot_ros2_control")],
)
def test_package_is_named_after_the_scenario(scenario: str, package: str) -> None:
    assert package_name_of(scenario) == package


@pytest.mark.parametrize("package", ["", "Arm", "a-b", "7a", "a__b", "a_", "a" * 61])
def test_invalid_package_names_are_refused(package: str) -> None:
    with pytest.raises(fjr.ParameterError, match=r"package is '.*'; expected a lower-case letter"):
        export_package(scenario("paper_k31"), package)


def test_law_in_python_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    made = parse_scenario("own", f"/**: {{ros__parameters: {{law.type: '{own_code.__name__}:Pd'}}}}")
    with pytest.raises(fjr.StateError, match="the law is written in Python; expected one made of expressions"):
        export_package(made, "own")
