# SPDX-License-Identifier: Apache-2.0
"""Changing a parameter of robot, gains, reference or integration changes the behaviour it names, in the nodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
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

COMMON = {
    "joint_stiffness": [40.0, 3.0, 3.0, 25.0],
    "motor_inertia": [0.03, 0.01],
    "link_damping": [0.3, 0.1],
    "motor_damping": [0.03, 0.01],
    "input_gain": [1.0, 0.5],
}
PLANAR = {"link_inertia": [0.02, 0.006], "link_mass": [1.0, 0.9], "link_length": [0.35, 0.25], "link_com": [0.1, 0.15]}
ONE = {"joint_stiffness": [20.0], "motor_inertia": [0.006], "link_damping": [0.3], "motor_damping": [0.02]}
ROBOTS: dict[str, dict[str, Any]] = {  # other values of all parameters of each model
    "single_link": {"link_inertia": [0.05], "gravity_torque": [1.3], "input_gain": [2.0], **ONE},
    "planar_two_link": {**PLANAR, "gravity": 1.62, **COMMON},
    "urdf": {"gravity": [0.0, 3.0, -9.0], "gear_ratio": [2.0, 1.5], **COMMON},
}
CURVED = {"cubic_stiffness": [5000.0, 5000.0]}  # K of ROBOTS couples the joints
GAIN_CASES = {"Lambda_l": 12.0, "Pi_l": 25.0, "K_ld": 0.7, "Lambda_m": 17.0}
GAIN_CASES |= {"Pi_m": 70.0, "K_md": 0.4, "Gamma_l": 2.0, "Gamma_m": 3.0}
REFERENCE_CASES = {"amplitude": 0.8, "frequency": 1.3, "offset": 0.1, "phase": 0.2}
INITIAL = ("initial_link_position", "initial_motor_position", "initial_link_velocity", "initial_motor_velocity")


def joints(model: str) -> list[str]:
    return {"single_link": ["joint1"], "planar_two_link": ["joint1", "joint2"], "urdf": JOINTS}[model]


def model_parameters(model: str) -> dict[str, Any]:
    parameters: dict[str, Any] = {"robot__model": model, "joints": joints(model)}
    if model == "urdf":
        parameters |= {"robot__urdf": URDF, "robot__joint_stiffness": STIFFNESS, "robot__motor_inertia": MOTOR_INERTIA}
    return parameters


def made(model: str, **parameters: Any) -> fjr.Robot:
    """Return the robot of a model with these parameters, by the function of fjr_core."""
    n = len(joints(model))
    values = {name: np.reshape(v, (n, n)) if np.size(v) == n * n > n else v for name, v in parameters.items()}
    cubic = values.pop("cubic_stiffness", None)
    robot = MODELS[model](**{name.replace("joint_stiffness", "stiffness"): value for name, value in values.items()})
    return robot if cubic is None else replace(robot, cubic=cubic)


def controller_effort(ros: Ros, model: str = "single_link", **parameters: Any) -> np.ndarray:
    """Return the effort of a controller node with these parameters at time T after a start at 0."""
    peer = Peer(ros)
    peer.lone_controller(**{"start__join_time": 0.0, **model_parameters(model), **parameters})
    names = [*joints(model), *(f"{joint}_motor" for joint in joints(model))]
    n = len(joints(model))
    peer.ask(stamped(0.0, names=names))
    return np.array(peer.ask(stamped(T, [Q_L] * n + [Q_M] * n, [DQ_L] * n + [DQ_M] * n, names)).effort)


def law_effort(robot: fjr.Robot, gains: fjr.Gains, reference: fjr.Sine) -> np.ndarray:
    ones = np.ones(robot.n)
    x = robot.state(Q_L * ones, Q_M * ones, DQ_L * ones, DQ_M * ones)
    return fjr.TrackingLaw(robot, gains).effort(x, x, reference.jets(T))


def unit_sine(n: int, **changes: float) -> fjr.Sine:
    return fjr.Sine(**{name: np.full(n, v) for name, v in {"amplitude": 1.0, "frequency": 1.0, **changes}.items()})


def assert_equal(found: np.ndarray, of: Callable[..., np.ndarray], values: dict[str, Any]) -> None:
    """Compare with `of(**values)`, which is another one without any of the values: each has its effect."""
    np.testing.assert_allclose(found, of(**values), rtol=1e-9)
    for name in values:
        default = of(**{other: value for other, value in values.items() if other != name})
        assert np.max(np.abs(found - default)) > 1e-6 * np.max(np.abs(default)), name


@pytest.mark.parametrize(("model", "values"), [*ROBOTS.items(), ("planar_two_link", CURVED)])
def test_both_nodes_have_the_robot_of_the_parameters_each_of_which_has_its_effect(
    ros: Ros, model: str, values: dict[str, Any]
) -> None:
    parameters, sine = {f"robot__{name}": value for name, value in values.items()}, unit_sine(len(joints(model)))
    with Ros() as alone:
        effort = controller_effort(alone, model, **parameters)
    assert_equal(effort, lambda **v: law_effort(made(model, **v), fjr.PAPER_GAINS, sine), values)
    assert_equal(measured(lockstep_state(ros, model, **parameters)), lambda **v: simulated(made(model, **v)), values)


def test_the_controller_has_gains_and_reference_of_the_parameters_each_of_which_has_its_effect(ros: Ros) -> None:
    gains = {f"gains__{name}": [value] for name, value in GAIN_CASES.items()}
    sine = {f"reference__{name}": [value] for name, value in REFERENCE_CASES.items()}

    def expected(**values: float) -> np.ndarray:
        changed = [{name: v for name, v in values.items() if name in cases} for cases in (GAIN_CASES, REFERENCE_CASES)]
        return law_effort(fjr.single_link(), replace(fjr.PAPER_GAINS, **changed[0]), unit_sine(1, **changed[1]))

    assert_equal(controller_effort(ros, **gains, **sine), expected, {**GAIN_CASES, **REFERENCE_CASES})


def lockstep_state(ros: Ros, model: str = "single_link", samples: int = 20, **parameters: Any) -> JointState:
    """Return the state of a plant node with these parameters after some samples of a constant effort."""
    peer = Peer(ros)
    peer.plant(**{"lockstep": True, **model_parameters(model), **parameters})
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


def test_the_plant_begins_at_the_initial_state_of_the_parameters(ros: Ros) -> None:
    values = [0.1, 0.2, 0.3, 0.4]
    first = lockstep_state(ros, samples=0, **{name: [value] for name, value in zip(INITIAL, values, strict=True)})
    assert measured(first) == pytest.approx(values)


def test_plant_integrator_and_inner_steps(ros: Ros) -> None:
    midpoint = measured(lockstep_state(ros, integrator="implicit_midpoint", inner_steps=2))
    expected = simulated(fjr.single_link(), integrator="implicit_midpoint", steps=2)
    np.testing.assert_allclose(midpoint, expected, rtol=1e-9)
    assert np.max(np.abs(midpoint - simulated(fjr.single_link(), steps=2))) > 1e-9
    assert np.max(np.abs(midpoint - simulated(fjr.single_link(), integrator="implicit_midpoint"))) > 1e-12


def test_plant_publish_rate(ros: Ros) -> None:
    assert nanoseconds(lockstep_state(ros, samples=3, publish_rate=250.0)) == LOCKSTEP_START + 3 * 4_000_000


WHEN = {
    ("plant", True): "may change while the node runs",
    ("plant", False): "fixed while the node runs",
    ("controller", True): "may change while the node is active",
    ("controller", False): "may change only while the node is unconfigured",
}


@pytest.mark.parametrize("kind", ["plant", "controller"])
def test_every_parameter_is_declared_with_description_unit_and_type(ros: Ros, kind: str) -> None:
    node = getattr(ros, kind)()
    own = {"plant": plant_parameters, "controller": controller_parameters}[kind]
    for parameter in all_parameters(own, {}):
        descriptor = node.describe_parameter(parameter.name)
        assert descriptor.read_only == (kind == "plant" and not parameter.dynamic)
        assert descriptor.additional_constraints.endswith(WHEN[kind, parameter.dynamic])
        assert parameter.description in descriptor.description
        assert parameter.unit in descriptor.description
        assert descriptor.type != ParameterType.PARAMETER_NOT_SET
        example = parameter.default[0] if isinstance(parameter.default, tuple) else parameter.default
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        assert ranges or descriptor.additional_constraints or type(example) in (bool, str), parameter.name
    assert node.describe_parameters(["publish_rate" if kind == "plant" else "state_timeout"])[0].floating_point_range
