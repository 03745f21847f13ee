# SPDX-License-Identifier: Apache-2.0
"""The exported controller and arm run against stand-ins: tracking, certificate, stops, requests, faults."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import fjr_core as fjr
from design.exports.c_program import program_output, scenario
from design.exports.ros2_control.exported_package import driver, exported, values
from fjr_core.config.law import gains as build_gains
from fjr_core.config.scenario import parse_scenario

PACKAGE = "two_link_ros2_control"


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
    n, step = 2, scenario("two_link").control_step()
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
    program, step = driver(exported(made, tmp_path / "p"), "torque_ros2_control"), made.control_step()
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
    assert tracked["certificates"] == 599  # the first sample has no predecessor
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
    assert found["moved_while_inactive"] == found["speed_while_inactive"] == 0  # held by its brakes


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
    assert "hold 0: another controller leads the reference; expected a request to that one" in output


def test_effort_limits_of_the_parameters_hold(drive: Path) -> None:
    lines = program_output(drive, "record", "limits.effort=0.5 0.25").splitlines()
    efforts = np.array([[float.fromhex(word) for word in line.split()[-2:]] for line in lines])
    assert np.array_equal(np.abs(efforts).max(axis=0), [0.5, 0.25])


def test_gains_of_the_parameters_replace_those_of_the_scenario(drive: Path) -> None:
    lines = program_output(drive, "record", "gains.K_md=0.5 0.25", "gains.Pi_m=80 40").splitlines()
    row = np.array([float.fromhex(word) for word in lines[7].split()])
    given = scenario("two_link")
    gains = {"gains.K_md": (0.5, 0.25), "gains.Pi_m": (80.0, 40.0)}
    law = fjr.TrackingLaw(given.robot, build_gains({**given.controller_values, **gains}, 2))
    u, _ = law.measured_command(row[:4], row[4:8], given.reference.jets(row[8] * 1e-9))
    assert row[9:] == pytest.approx(u, rel=1e-12)


def test_configures_with_valid_parameters_at_the_exported_rate_only(drive: Path) -> None:
    output = program_output(drive, "configure")
    found = values(output)
    assert [found[f"configures_at_{rate}"] for rate in (0, 500, 1000)] == [0, 0, 1]
    assert found["short_list"] == found["negative_limit"] == found["unknown_policy"] == 0
    assert "parameter 'limits.effort' is 1 numbers; expected 2" in output
    assert "parameter 'on_stop' is brake; expected zero or gravity_hold" in output


INVALID = {
    r"parameter 'actuator_lag' is ": ["actuator_lag=-1", "actuator_lag=1 2 3", "actuator_lag=x"],
    r"parameter '(time|seed|payload)' is ": ["time=now", "seed=", "payload=1"],
    r"a delay is \S+ samples; expected at most 10000": ["state_delay=inf", "command_delay=1e300"],
}


@pytest.mark.parametrize("sentence", INVALID)
def test_arm_refuses_invalid_parameters_in_one_sentence(drive: Path, sentence: str) -> None:
    for parameter in INVALID[sentence]:
        assert re.search(sentence, program_output(drive, "record", parameter, code=2)), parameter


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


def test_services_hold_play_and_resume(drive: Path) -> None:
    output = program_output(drive, "request", "limits.link_velocity=50 50")
    found = values(output)
    assert found["speed_held"] < 1e-3
    assert found["speed_playing"] > 0.1
    assert [found[f"state_{when}"] for when in ("playing", "stopped", "resumed")] == [2, 3, 2]
    assert [line for line in output.splitlines() if ": " in line and line.split()[0] in ("hold", "play", "resume")] == [
        "resume 0: the controller is not stopped; expected a stopped one",
        "hold 1: the motion comes to a standstill",
        "play 1: transition to the built-in reference",
        "resume 0: shoulder is outside its limits; expected it within them",
        "resume 1: tracking resumes",
        "hold 0: the controller is inactive; expected an active one",
    ]


SAFE = (
    *("limits.effort=5 3", "state_timeout=0.1", "recovery.join_time=0.5"),
    "limits.acceleration=200 200",  # no transition is longer
)
FAULTS = {
    "none:0.2": (0.0, set()),
    "not_finite:0.2": (1.0, {"silences", "recoveries"}),
    "huge:0.2": (1.0, {"efforts not finite"}),
    "stamp_not_finite:0.2": (1.0, {"silences", "recoveries"}),
    "stamp_out_of_range:0.2": (1.0, {"silences", "recoveries"}),
    "repeated:0.2": (1.0, {"silences", "recoveries"}),
    "repeated:2": (2.0, {"silences", "recoveries"}),
    "no_update:0.05": (0.5, set()),
    "no_update:0.2": (1.0, {"forward jumps", "recoveries"}),
    "few_updates:1": (0.1, set()),
    "older:1": (1.0, set()),
    "jump:0.5": (2.0, {"forward jumps", "recoveries", "reference restarts"}),
}
"""Faults by name and length [s]: longest time [s] to recover, and events that must be reported."""


@pytest.mark.parametrize("fault", FAULTS)
def test_under_a_fault_every_effort_is_finite_and_limited_and_tracking_recovers(drive: Path, fault: str) -> None:
    recovery, events = FAULTS[fault]
    output = program_output(drive, "fault", f"fault={fault}", *SAFE)
    found = values(output)
    assert found["bad"] == 0
    assert found["recovery"] <= recovery
    assert events <= set(output.splitlines()[-1].removeprefix("events ").split(";"))


@pytest.mark.parametrize(("delay", "tracks"), [(0.001, True), (0.008, True), (0.02, False)])
def test_late_states_never_give_an_effort_beyond_its_limit(drive: Path, delay: float, tracks: bool) -> None:
    found = values(program_output(drive, "fault", "fault=none:0.2", f"state_delay={delay}", *SAFE))
    assert found["bad"] == 0
    assert (found["recovery"] < 1) == tracks


def test_saturated_joints_are_named(drive: Path) -> None:
    output = program_output(drive, "stop", "limits.effort=0.5 0.25")
    assert "efforts saturated, shoulder, elbow" in output.splitlines()
    assert "efforts saturated;" in output
