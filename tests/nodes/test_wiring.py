# SPDX-License-Identifier: Apache-2.0
"""Changing each declared parameter changes the behaviour it names, and no parameter is left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcl_interfaces.msg import ParameterType
from sensor_msgs.msg import JointState

import fjr_core as fjr
from fjr_core.config.controller import controller_parameters
from fjr_core.config.nodes import all_parameters
from fjr_core.config.plant import plant_parameters
from fjr_plant.lock_step import START as LOCKSTEP_START
from nodes.harness import Peer, Ros, nanoseconds, stamped
from two_link_urdf import JOINTS, MOTOR_INERTIA, STIFFNESS, two_link_urdf

URDF = two_link_urdf(wrist_mass=0.5)


def from_urdf(**arguments: Any) -> fjr.Robot:
    return fjr.robot_from_urdf(URDF, JOINTS, **{"stiffness": STIFFNESS, "motor_inertia": MOTOR_INERTIA, **arguments})


MODELS = {"single_link": fjr.single_link, "planar_two_link": fjr.planar_two_link, "urdf": from_urdf}
T, Q_L, Q_M, DQ_L, DQ_M = 0.3, 0.4, 0.45, 0.2, -0.1  # an instant at which every parameter matters

ROBOT_CASES = [  # model, parameter, argument of the model's function, value
    ("single_link", "link_inertia", "link_inertia", [0.05]),
    ("single_link", "gravity_torque", "gravity_torque", [1.3]),
    ("single_link", "joint_stiffness", "stiffness", [20.0]),
    ("single_link", "motor_inertia", "motor_inertia", [0.006]),
    ("single_link", "link_damping", "link_damping", [0.3]),
    ("single_link", "motor_damping", "motor_damping", [0.02]),
    ("single_link", "input_gain", "input_gain", [2.0]),
    ("planar_two_link", "link_inertia", "link_inertia", [0.02, 0.006]),
    ("planar_two_link", "link_mass", "link_mass", [1.0, 0.9]),
    ("planar_two_link", "link_length", "link_length", [0.35, 0.25]),
    ("planar_two_link", "link_com", "link_com", [0.1, 0.15]),
    ("planar_two_link", "gravity", "gravity", 1.62),
    ("planar_two_link", "joint_stiffness", "stiffness", [40.0, 3.0, 3.0, 25.0]),
    ("planar_two_link", "motor_inertia", "motor_inertia", [0.03, 0.01]),
    ("planar_two_link", "link_damping", "link_damping", [0.3, 0.1]),
    ("planar_two_link", "motor_damping", "motor_damping", [0.03, 0.01]),
    ("planar_two_link", "input_gain", "input_gain", [1.0, 0.5]),
    ("urdf", "gravity", "gravity", [0.0, 3.0, -9.0]),
    ("urdf", "joint_stiffness", "stiffness", [40.0, 3.0, 3.0, 25.0]),
    ("urdf", "motor_inertia", "motor_inertia", [0.03, 0.01]),
    ("urdf", "gear_ratio", "gear_ratio", [2.0, 1.5]),
    ("urdf", "link_damping", "link_damping", [0.3, 0.1]),
    ("urdf", "motor_damping", "motor_damping", [0.03, 0.01]),
    ("urdf", "input_gain", "input_gain", [1.0, 0.5]),
]
GAIN_CASES = {
    "Lambda_l": 12.0,
    "Pi_l": 25.0,
    "K_ld": 0.7,
    "Lambda_m": 17.0,
    "Pi_m": 70.0,
    "K_md": 0.4,
    "Gamma_l": 2.0,
    "Gamma_m": 3.0,
}
REFERENCE_CASES = {"amplitude": 0.8, "frequency": 1.3, "offset": 0.1, "phase": 0.2}
INITIAL_CASES = {
    "initial_link_position": 0,
    "initial_motor_position": 1,
    "initial_link_velocity": 2,
    "initial_motor_velocity": 3,
}


def joints(model: str) -> list[str]:
    return {"single_link": ["joint1"], "planar_two_link": ["joint1", "joint2"], "urdf": JOINTS}[model]


def model_parameters(model: str) -> dict[str, Any]:
    parameters: dict[str, Any] = {"robot__model": model, "joints": joints(model)}
    if model == "urdf":
        parameters |= {"robot__urdf": URDF, "robot__joint_stiffness": STIFFNESS, "robot__motor_inertia": MOTOR_INERTIA}
    return parameters


def given(model: str) -> dict[str, Any]:
    return {name.replace("__", "."): value for name, value in model_parameters(model).items()}


def matrix(value: Any, n: int) -> Any:
    return np.reshape(value, (n, n)) if np.size(value) == n * n > n else value


def controller_effort(ros: Ros, model: str = "single_link", **parameters: Any) -> np.ndarray:
    """Return the effort of a controller node with these parameters at time T after a start at 0."""
    peer = Peer(ros)
    ros.controller(**{"start__join_time": 0.0, **model_parameters(model), **parameters})
    peer.meet_controller()
    names = [*joints(model), *(f"{joint}_motor" for joint in joints(model))]
    n = len(joints(model))
    peer.ask(stamped(0.0, names=names))
    return np.array(peer.ask(stamped(T, [Q_L] * n + [Q_M] * n, [DQ_L] * n + [DQ_M] * n, names)).effort)


def law_effort(robot: fjr.Robot, gains: fjr.Gains, reference: fjr.Sine) -> np.ndarray:
    ones = np.ones(robot.n)
    x = robot.state(Q_L * ones, Q_M * ones, DQ_L * ones, DQ_M * ones)
    return fjr.TrackingLaw(robot, gains).effort(x, x, reference.jets(T))


def test_controller_locked_joints(ros: Ros) -> None:
    bent = {"robot__locked_joints": ["wrist"], "robot__locked_positions": [0.9]}
    changed = controller_effort(ros, "urdf", **bent)
    expected = law_effort(from_urdf(locked={"wrist": 0.9}), fjr.PAPER_GAINS, unit_sine(2))
    assert_changed(changed, expected, law_effort(from_urdf(), fjr.PAPER_GAINS, unit_sine(2)))


ROBOT_FILE = f"""/**:
  ros__parameters:
    joints: {JOINTS}
    robot: {{model: urdf, urdf: arm.urdf, joint_stiffness: [50.0, 30.0], motor_inertia: {MOTOR_INERTIA}}}
"""


def test_controller_robot_file_and_its_overrides(ros: Ros, tmp_path: Path) -> None:
    (tmp_path / "arm.yaml").write_text(ROBOT_FILE)
    (tmp_path / "arm.urdf").write_text(URDF)
    peer = Peer(ros)
    own = {"robot__joint_stiffness": STIFFNESS, "start__join_time": 0.0}
    node = ros.controller(robot__file=str(tmp_path / "arm.yaml"), **own)
    peer.meet_controller()
    names = [*JOINTS, *(f"{joint}_motor" for joint in JOINTS)]
    peer.ask(stamped(0.0, names=names))
    effort = peer.ask(stamped(T, [Q_L] * 2 + [Q_M] * 2, [DQ_L] * 2 + [DQ_M] * 2, names)).effort
    np.testing.assert_allclose(effort, law_effort(from_urdf(), fjr.PAPER_GAINS, unit_sine(2)), rtol=1e-9)
    assert node.get_parameter("joints").value == JOINTS
    assert node.get_parameter("robot.urdf").value == str(tmp_path / "arm.urdf")


def test_compiled_controller_sends_the_same_effort(ros: Ros) -> None:
    effort = controller_effort(ros, compile=True)
    np.testing.assert_allclose(effort, law_effort(fjr.single_link(), fjr.PAPER_GAINS, unit_sine(1)), rtol=1e-9)


def test_compiled_plant_moves_identically(ros: Ros) -> None:
    np.testing.assert_allclose(measured(lockstep_state(ros, compile=True)), simulated(fjr.single_link()), rtol=1e-9)


def unit_sine(n: int, **changes: float) -> fjr.Sine:
    return fjr.Sine(**{name: np.full(n, v) for name, v in {"amplitude": 1.0, "frequency": 1.0, **changes}.items()})


def assert_changed(changed: np.ndarray, expected: np.ndarray, default: np.ndarray) -> None:
    np.testing.assert_allclose(changed, expected, rtol=1e-9)
    assert np.max(np.abs(changed - default)) > 1e-6 * np.max(np.abs(default))


@pytest.mark.parametrize(("model", "parameter", "argument", "value"), ROBOT_CASES)
def test_controller_robot(ros: Ros, model: str, parameter: str, argument: str, value: Any) -> None:
    changed = controller_effort(ros, model, **{f"robot__{parameter}": value})
    make, n = MODELS[model], len(joints(model))
    expected = law_effort(make(**{argument: matrix(value, n)}), fjr.PAPER_GAINS, unit_sine(n))
    assert_changed(changed, expected, law_effort(make(), fjr.PAPER_GAINS, unit_sine(n)))


@pytest.mark.parametrize("name", GAIN_CASES)
def test_controller_gains(ros: Ros, name: str) -> None:
    changed = controller_effort(ros, **{f"gains__{name}": [GAIN_CASES[name]]})
    expected = law_effort(fjr.single_link(), replace(fjr.PAPER_GAINS, **{name: GAIN_CASES[name]}), unit_sine(1))
    assert_changed(changed, expected, law_effort(fjr.single_link(), fjr.PAPER_GAINS, unit_sine(1)))


@pytest.mark.parametrize("name", REFERENCE_CASES)
def test_controller_reference(ros: Ros, name: str) -> None:
    changed = controller_effort(ros, **{f"reference__{name}": [REFERENCE_CASES[name]]})
    expected = law_effort(fjr.single_link(), fjr.PAPER_GAINS, unit_sine(1, **{name: REFERENCE_CASES[name]}))
    assert_changed(changed, expected, law_effort(fjr.single_link(), fjr.PAPER_GAINS, unit_sine(1)))


def test_controller_joints(ros: Ros) -> None:
    peer = Peer(ros)
    ros.controller(joints=["elbow"])
    peer.meet_controller()
    assert list(peer.ask(stamped(0.0, names=["elbow", "elbow_motor"])).name) == ["elbow"]


def lockstep_state(ros: Ros, model: str = "single_link", samples: int = 20, **parameters: Any) -> JointState:
    """Return the state of a plant node with these parameters after some samples of a constant effort."""
    peer = Peer(ros)
    ros.plant(**{"lockstep": True, **model_parameters(model), **parameters})
    peer.meet_plant(lockstep=True)
    names = joints(model)
    for _ in range(samples):
        state, count = peer.states[-1], len(peer.states)
        command = JointState(name=names, effort=[0.5] * len(names))
        command.header.stamp = state.header.stamp
        peer.command_publisher.publish(command)
        ros.until(lambda count=count, state=state: nanoseconds(peer.states[-1]) > nanoseconds(state), "a state")
    return peer.states[-1]


def simulated(robot: fjr.Robot, samples: int = 20, integrator: str = "rk4", steps: int = 4) -> np.ndarray:
    """Return the positions and velocities that the plant must report, computed by fjr_core."""
    plant, half, zero = fjr.Plant(robot, integrator), np.full(robot.n, 0.5), np.zeros(robot.n)
    x = robot.state(half, half, zero, zero)
    for _ in range(samples * steps):
        x = plant.step(x, half, 1e-3 / steps)
    return np.concatenate([x[: 2 * robot.n], *robot.velocities(x)])


def measured(state: JointState) -> np.ndarray:
    return np.array([*state.position, *state.velocity])


@pytest.mark.parametrize(("model", "parameter", "argument", "value"), ROBOT_CASES)
def test_plant_robot(ros: Ros, model: str, parameter: str, argument: str, value: Any) -> None:
    changed = measured(lockstep_state(ros, model, **{f"robot__{parameter}": value}))
    make, n = MODELS[model], len(joints(model))
    assert_changed(changed, simulated(make(**{argument: matrix(value, n)})), simulated(make()))


@pytest.mark.parametrize("name", INITIAL_CASES)
def test_plant_initial_state(ros: Ros, name: str) -> None:
    first = lockstep_state(ros, samples=0, **{name: [0.7]})
    assert measured(first)[INITIAL_CASES[name]] == pytest.approx(0.7)
    assert np.count_nonzero(measured(first) == 0.7) <= 1


def test_plant_integrator_and_inner_steps(ros: Ros) -> None:
    midpoint = measured(lockstep_state(ros, integrator="implicit_midpoint", inner_steps=2))
    expected = simulated(fjr.single_link(), integrator="implicit_midpoint", steps=2)
    np.testing.assert_allclose(midpoint, expected, rtol=1e-9)
    assert np.max(np.abs(midpoint - simulated(fjr.single_link(), steps=2))) > 1e-9


def test_plant_inner_steps(ros: Ros) -> None:
    coarse = measured(lockstep_state(ros, inner_steps=1))
    np.testing.assert_allclose(coarse, simulated(fjr.single_link(), steps=1), rtol=1e-12)
    assert np.max(np.abs(coarse - simulated(fjr.single_link(), steps=4))) > 1e-12


def test_plant_publish_rate(ros: Ros) -> None:
    assert nanoseconds(lockstep_state(ros, samples=3, publish_rate=250.0)) == LOCKSTEP_START + 3 * 4_000_000


def test_plant_wait_for_command_can_be_disabled(ros: Ros, peer: Peer) -> None:
    ros.plant(wait_for_command=False)
    ros.until(lambda: peer.states and peer.states[-1].position[0] < 0.499, "the fall of the link")


def test_plant_joints(ros: Ros, peer: Peer) -> None:
    ros.plant(joints=["elbow"])
    ros.until(lambda: peer.states)
    assert list(peer.states[-1].name) == ["elbow", "elbow_motor"]


WIRED_ELSEWHERE = {
    "robot.model",  # every planar_two_link and urdf case
    "robot.urdf",  # every urdf case
    "robot.file",  # test_controller_robot_file_and_its_overrides
    "robot.locked_joints",  # test_controller_locked_joints
    "robot.locked_positions",
    "compile",  # test_compiled_...
    "autostart",  # test_lifecycle
    "certificate",  # test_certificate
    "certificate_tolerance",  # test_certificate
    "auxiliary_rate",  # test_native_loop
    "executor",  # test_native_loop, tests/msgs/test_scheduling.py
    "lock_memory",
    "cpu_affinity",
    "lockstep",  # every lockstep_state
    "lockstep_timeout",  # test_lock_step
    "restart_silence",  # test_stamps_of_states
    "publish_description",  # test_plant_node
    "advance_samples",  # test_advance
    "state_timeout",  # test_controller_node
    "command_timeout",  # test_plant_node
    "start_paused",  # test_plant_node
    "realtime_priority",  # tests/system/test_executables.py
    "joints",
    "publish_rate",
    "inner_steps",
    "integrator",
    "wait_for_command",
}


WIRED_BY_GROUP = (
    "reference.",  # tests/core/config/test_reference.py, test_lifecycle
    "imperfections.",  # test_plant_imperfections, test_simulated_robot
    "measurement.",  # tests/core/runtime/test_measurement.py, test_limits_over_ros
    "limits.",  # tests/tracking, test_limits_over_ros
    "on_stop",
    "start.",
    "recovery.",
    "hold.",
    "constraints.",  # test_follow_action
    "allow_partial_joints",  # test_trajectories
    "law.",  # test_other_laws, tests/design/tuning/test_equal_bandwidth.py
    "plant.",  # test_own_code
    "robust.",  # test_other_laws
    "robot.guesses.",  # tests/core/config/test_guesses.py
)


@pytest.mark.parametrize("model", MODELS)
def test_no_parameter_is_left_out(model: str) -> None:
    tested = WIRED_ELSEWHERE | set(INITIAL_CASES)
    tested |= {f"robot.{parameter}" for case_model, parameter, _, _ in ROBOT_CASES if case_model == model}
    tested |= {f"gains.{name}" for name in GAIN_CASES} | {f"reference.{name}" for name in REFERENCE_CASES}
    for own in (plant_parameters, controller_parameters):
        names = {parameter.name for parameter in all_parameters(own, given(model))} - tested
        assert {name for name in names if not name.startswith(WIRED_BY_GROUP)} == set()


@pytest.mark.parametrize("kind", ["plant", "controller"])
def test_every_parameter_is_declared_with_description_unit_and_type(ros: Ros, kind: str) -> None:
    node = getattr(ros, kind)()
    own = {"plant": plant_parameters, "controller": controller_parameters}[kind]
    for parameter in all_parameters(own, {}):
        descriptor = node.describe_parameter(parameter.name)
        assert descriptor.read_only == (kind == "plant" and not parameter.dynamic)
        assert parameter.description in descriptor.description
        assert parameter.unit in descriptor.description
        assert descriptor.type != ParameterType.PARAMETER_NOT_SET
        example = parameter.default[0] if isinstance(parameter.default, tuple) else parameter.default
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        assert ranges or descriptor.additional_constraints or type(example) in (bool, str), parameter.name
    assert node.describe_parameters(["publish_rate" if kind == "plant" else "state_timeout"])[0].floating_point_range
