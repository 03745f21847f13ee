# SPDX-License-Identifier: Apache-2.0
"""The predicted motion is that of SciPy's integrator, its sensitivities those of differences; corrected links exist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import PlanarTwoLink
from core.oracles.elastic_joint import ElasticJoint, integrated, multi_sine
from fjr_core.model.newton_euler import serial_chain
from fjr_core.model.rigid_arm import Body
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_identification.estimation.elastic_arm import ElasticArm, corrected_body, packed
from fjr_identification.estimation.estimation_problem import Estimation
from fjr_identification.estimation.filtered_fit import filtered_fit
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.multiple_shooting import Problem, Segment
from fjr_identification.estimation.parameters import (
    KINDS,
    LAG,
    PSEUDO_INERTIA,
    RATIO,
    SMOOTHING,
    STRIBECK,
    USUAL,
    USUAL_SMOOTHING,
    USUAL_STRIBECK,
    IdentifyOptions,
    ParameterCoordinates,
    prior_of,
    size,
)
from fjr_identification.estimation.shooting import HeldEffort, Shooting, behind
from fjr_identification.robot_file import with_inertias

FREE = (
    "joint_stiffness",
    "motor_inertia",
    "link_damping",
    "motor_coulomb_friction",
    SMOOTHING,
    "offset",
    "effort_delay",
    LAG,
    "link_skew",
    RATIO,
)


def held(u: Array, dt: float, parts: int) -> HeldEffort:
    none = np.zeros(2 * u.shape[1])
    return HeldEffort(u, dt, parts, none, none)


def values(n: int, **given: float) -> dict[str, Array]:
    zeros = {name: np.zeros(size(name, n)) for name in KINDS}
    usual = {SMOOTHING: np.full(n, USUAL_SMOOTHING), STRIBECK: np.full(n, USUAL_STRIBECK)}
    return {**zeros, **usual, **{name: np.full(n, value) for name, value in given.items()}}


def parameters(joint: ElasticJoint) -> dict[str, Array]:
    return values(
        1,
        joint_stiffness=joint.K,
        motor_inertia=joint.B,
        link_damping=joint.D_l,
        motor_damping=joint.D_m,
        link_coulomb_friction=joint.F_l,
        motor_coulomb_friction=joint.F_m,
        offset=joint.offset,
        effort_delay=joint.delay,
        link_skew=joint.skew,
    )


def test_prediction_equals_the_integral_of_scipy() -> None:
    joint, dt = ElasticJoint(skew=0.0), 2e-3
    u = multi_sine(np.arange(200) * dt, np.array([0.9, 4.0, 12.0]), 0.5, 3)
    link, motor = integrated(joint, u, dt)
    arm = ElasticArm(fjr.single_link(link_inertia=joint.M, gravity_torque=joint.load), ())
    p, start = parameters(joint), np.array([0.0, joint.offset, 0.0, 0.0])
    even = [held(u[:, None], dt, parts) for parts in (16, 32, 2)]
    halved = replace(even[-1], mobility=np.array([1 / joint.M, 1 / joint.B]), accuracy=np.full(2, 1e-9))
    errors = []
    for effort in (*even, halved):
        found = Shooting(arm, ())(start, effort, 0, len(u) - 1, p)
        assert found is not None
        errors.append(np.max(np.abs(found[0][:, :2] - np.column_stack([link, motor]))))
    assert errors[1] < 2e-7
    assert errors[1] < errors[0] / 8
    assert errors[3] < errors[2] / 100  # steps are short where friction turns over


def test_accelerations_of_two_links_equal_the_closed_form() -> None:
    joints, links = [0.3, 0.25], PlanarTwoLink([1.2, 0.8], 0.3, [0.15, 0.12], [0.010, 0.005])
    robot = fjr.planar_two_link(link_length=joints)
    p = values(2, link_damping=0.2, motor_damping=0.1, offset=0.01, link_coulomb_friction=0.3)
    p |= {"joint_stiffness": np.array([40.0, 25.0]), "motor_inertia": np.array([0.02, 0.01])}
    arm, random = ElasticArm(robot, ()), np.random.default_rng(5)
    for _ in range(5):
        q_l, q_m, v_l, v_m, u = random.normal(size=(5, 2))
        found = arm.accelerations(np.concatenate([q_l, q_m, v_l, v_m]), u, packed(arm, p))[0].full().ravel()
        tau = p["joint_stiffness"] * (q_m - q_l - 0.01)
        on_links = tau - links.C(q_l, v_l) @ v_l - links.grad_P(q_l) - 0.2 * v_l - 0.3 * np.tanh(v_l / 0.01)
        expected = [np.linalg.solve(links.M(q_l), on_links), (u - tau - 0.1 * v_m) / p["motor_inertia"]]
        np.testing.assert_allclose(found, np.concatenate(expected), rtol=1e-9)


@pytest.mark.parametrize("name", FREE)
def test_sensitivities_equal_central_differences(name: str) -> None:
    joint, dt = ElasticJoint(delay=2.6e-3, skew=1.3e-3), 2e-3
    robot = fjr.single_link(link_inertia=joint.M, gravity_torque=joint.load)
    u = multi_sine(np.arange(60) * dt, np.array([3.0, 11.0]), 0.8, 1)[:, None]
    silent = np.zeros_like(u)
    record = MotionRecord("a record", ("joint1",), dt, u, silent, silent, np.full_like(u, np.nan))
    segment = Segment(record, held(u, dt, 2), 6, 48, 6)
    given = parameters(joint) | {LAG: np.array([1.5e-3]), RATIO: np.array([4e-3])}
    coordinates = ParameterCoordinates(((name, 0),), given, np.ones(1))
    arm = ElasticArm(robot, coordinates.dynamic)
    shooting, signals = Shooting(arm, coordinates.delays), (("q_l", 0), ("q_m", 0))

    x = np.array([0.2, 0.21, 0.5, 0.4])
    problem = Problem([segment], shooting, coordinates, signals, np.ones(2), x[None], np.ones(4))

    def predicted(z: Array) -> Array:
        found = problem.compare(0, z, x, np.ones(2))
        assert found is not None
        return found.predicted

    z, step = coordinates.mean, 1e-5 * max(abs(coordinates.mean[0]), 1e-5 if name == LAG else 1e-2)
    found = problem.compare(0, z, x, np.ones(2))
    assert found is not None
    difference = (predicted(z + step) - predicted(z - step)) / (2 * step)
    residual = -predicted(z)
    assert found.H[4, 4] == pytest.approx(np.sum(difference**2), rel=1e-4)
    assert found.g[4] == pytest.approx(np.sum(difference * residual), rel=1e-4)


@pytest.mark.parametrize("lag", [0.0, 5e-4, 2e-3, 5e-3])
def test_efforts_behind_a_lag_have_its_gain_and_phase(lag: float) -> None:
    dt, samples = 1e-3, 4000
    shooting = Shooting(ElasticArm(fjr.single_link(), ()), ())
    for frequency in (1.0, 5.0, 10.0):
        s = 2j * np.pi * frequency
        u = np.exp(s * dt * np.arange(samples))
        lags = np.array([lag / dt]).tobytes()
        efforts = (held(np.ascontiguousarray(part)[:, None], dt, 1) for part in (u.real, u.imag))
        real, imaginary = (behind(effort, *shooting.library, lags)[:, -1, 0] for effort in efforts)
        found = complex(real[0], imaginary[0]) / u[-1]
        early = (np.sqrt(1 + 4 * (lag / dt) ** 2) - 1) / 2 * dt  # by which the delay is shorter
        third = abs(s * lag) ** 2 * abs(s) * max(lag, dt) / 3
        assert abs(found * np.exp(s * early) - np.exp(s * lag) / (1 + s * lag)) <= third / 4 + 1e-9


def three_joints() -> Robot:
    """Return an arm whose sensitivities with all usual parameters are more than a block of columns."""
    body = Body(np.eye(3), np.array([0.0, 0.0, 0.3]), np.array([0.0, 1.0, 0.0]), 2.0, np.zeros(3), 0.02 * np.eye(3))
    turned = replace(body, axis=np.array([0.0, 0.0, 1.0]), com=np.array([0.05, 0.02, 0.1]))
    one, none = np.eye(3), np.zeros((3, 3))
    return Robot(serial_chain([body, turned, body]), M_m=0.1 * one, K=300 * one, D_l=none, D_m=none, B_m=one)


def test_all_columns_of_the_sensitivities_are_the_derivatives_of_the_motion() -> None:
    robot, dt, random = three_joints(), 1e-3, np.random.default_rng(2)
    p = values(3, joint_stiffness=300.0, motor_inertia=0.1, link_damping=0.3, motor_coulomb_friction=0.2, offset=0.01)
    free = [(name, j) for name in USUAL[:7] for j in range(3)]
    free += [("effort_delay", 0), ("effort_delay", 2)]
    coordinates = ParameterCoordinates(tuple(free), p, np.ones(len(free)))
    arm = ElasticArm(robot, coordinates.dynamic)
    shooting, effort = Shooting(arm, coordinates.delays), held(2 * random.standard_normal((30, 3)), dt, 2)
    assert coordinates.delays == (0, 2)
    assert shooting.padded > 8 * shooting.vectors
    x0, z = 0.5 * random.standard_normal(12), np.concatenate([coordinates.mean[:-2], [3.3e-3, 2.6e-3]])
    direction = random.standard_normal(shooting.columns) * np.concatenate([np.ones(33), [1e-3, 1e-3]])

    def moved(step: float) -> tuple[Array, Array]:
        at = coordinates.parameters(z + step * direction[12:])
        found = shooting(x0 + step * direction[:12], effort, 6, 20, at)
        assert found is not None
        return found

    S = moved(0.0)[1] * np.concatenate([np.ones(12), coordinates.scale(z)])
    difference = (moved(1e-5)[0] - moved(-1e-5)[0]) / 2e-5
    np.testing.assert_allclose(S @ direction, difference, rtol=0, atol=1e-6 * np.max(np.abs(difference)))


@pytest.mark.parametrize("rows", [3, 21])
def test_normal_equations_are_products_of_the_jacobian(rows: int) -> None:
    random, shooting = np.random.default_rng(rows), Shooting(ElasticArm(fjr.single_link(), ()), ())
    J, r = random.standard_normal((rows, 5)), random.standard_normal(rows)
    H, g = shooting.normal_equations(J, r)
    np.testing.assert_allclose(H, J.T @ J, rtol=0, atol=1e-13)
    np.testing.assert_allclose(g, J.T @ r, rtol=0, atol=1e-13)


def test_prior_of_a_robot_holds_its_values_and_those_that_are_given_but_no_inertia_without_bodies() -> None:
    robot, silent = fjr.planar_two_link(), np.zeros((500, 2))
    record = MotionRecord("a record", ("a", "b"), 2e-3, silent, silent, silent, np.full_like(silent, np.nan))
    with pytest.raises(fjr.FjrError, match="expected one from a URDF"):
        _ = Estimation([record], robot, prior_of(robot), IdentifyOptions(link_inertia=True)).coordinates
    prior = prior_of(robot, {"joint_stiffness": [50.0, 20.0]})
    np.testing.assert_array_equal(prior["joint_stiffness"], [50.0, 20.0])
    np.testing.assert_array_equal(prior["motor_inertia"], np.diag(robot.M_m))
    with pytest.raises(fjr.FjrError, match="K is not diagonal; expected one number per joint"):
        prior_of(replace(robot, K=np.array([[40.0, 1.0], [1.0, 25.0]])))


BODIES = (
    Body(np.eye(3), [0, 0, 0.1], [0, 1, 0], 3.0, [0.02, 0.01, 0.2], np.diag([0.03, 0.02, 0.01])),
    Body(np.eye(3), [0, 0, 0.4], [1, 0, 0], 2.0, [0.0, 0.03, 0.15], np.diag([0.02, 0.01, 0.02])),
)


def robot_of(bodies: tuple[Body, ...]) -> Robot:
    one, none = np.eye(2), np.zeros((2, 2))
    return Robot(serial_chain(bodies), M_m=0.2 * one, K=900 * one, D_l=none, D_m=none, B_m=one)


def corrected(bodies: tuple[Body, ...], theta: np.ndarray) -> tuple[Body, ...]:
    """Return the bodies in the frames of the chain, whose axes are z, with corrections (n, 10)."""
    return tuple(corrected_body(body, each) for body, each in zip(serial_chain(bodies).bodies, theta, strict=True))


def test_a_body_without_a_correction_is_itself() -> None:
    for body in BODIES:
        same = corrected_body(body, np.zeros(10))
        found, expected = ([each.mass, *each.com, *np.ravel(each.inertia)] for each in (same, body))
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("size", [0.1, 3.0])
def test_every_correction_is_a_body_that_can_exist(size: float) -> None:
    random = np.random.default_rng(2)
    for _ in range(20):
        body = corrected_body(BODIES[0], size * random.standard_normal(10))
        moments = np.linalg.eigvalsh(np.asarray(body.inertia))
        assert body.mass > 0
        assert moments[0] > 0
        assert moments[2] <= (moments[0] + moments[1]) * (1 + 1e-9)  # triangle inequality


def test_torques_of_the_corrected_arm_are_those_of_the_corrected_bodies() -> None:
    random, robot = np.random.default_rng(3), robot_of(BODIES)
    theta = 0.2 * random.standard_normal((2, 10))
    p = values(2, joint_stiffness=900.0, motor_inertia=0.2)
    p |= {name: theta[:, k] for k, name in enumerate(PSEUDO_INERTIA)}
    arm = ElasticArm(robot, ((PSEUDO_INERTIA[0], 0),))
    other = ElasticArm(robot_of(corrected(BODIES, theta)), ())
    for _ in range(3):
        x, u = random.normal(size=8), random.normal(size=2)
        found, expected = (each.accelerations(x, u, packed(each, p))[0].full() for each in (arm, other))
        np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_heavier_link_is_found_from_the_torques_that_its_motion_needs() -> None:
    theta = np.zeros((2, 10))
    theta[1, 0] = 0.1  # mass and inertia 22 % larger
    true, nominal = robot_of(corrected(BODIES, theta)), robot_of(BODIES)
    dt, f = 2e-3, np.array([0.4, 1.1])
    t = dt * np.arange(4000)
    phases = 2 * np.pi * (f * t[:, None])
    q, v = 0.8 * np.sin(phases), 0.8 * 2 * np.pi * f * np.cos(phases)
    a = -((2 * np.pi * f) ** 2) * q
    tau = np.asarray(true.links.inertial_torque(q.T, v.T, v.T, a.T) + true.links.grad_P_l(q.T)).T
    motor = q + tau / 900 + 1e-6 * np.random.default_rng(4).standard_normal(q.shape)
    record = MotionRecord("a record", ("a", "b"), dt, tau + 0.2 * a, q, motor, np.full_like(q, np.nan))
    setup = Estimation([record], nominal, prior_of(nominal), IdentifyOptions(link_inertia=True))
    z = filtered_fit(setup, setup.coordinates.mean)
    p = setup.coordinates.parameters(z)
    bodies = corrected(BODIES, np.column_stack([p[name] for name in PSEUDO_INERTIA]))
    found = robot_of(bodies)
    assert p["joint_stiffness"] == pytest.approx([900, 900], rel=0.04)
    for each in (np.array([0.3, 0.5]), np.array([-0.4, 0.7])):
        load, expected, before = (np.asarray(robot.grad_P_l(each)) for robot in (found, true, nominal))
        assert np.linalg.norm(load - expected) < 0.25 * np.linalg.norm(before - expected)


URDF = """\
<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.01 0 0.2" rpy="0.3 0 0"/><mass value="3"/>
    <inertia ixx="0.03" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tool"><inertial><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="a" type="revolute"><parent link="base"/><child link="upper"/><origin rpy="0.2 0 0.4"/>
    <axis xyz="0 0.6 0.8"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
  <joint name="flange" type="fixed"><parent link="upper"/><child link="tool"/><origin xyz="0 0 0.4"/></joint>
</robot>"""


def test_corrected_links_are_written_into_the_urdf() -> None:
    before = fjr.robot_from_urdf(URDF, ["a"], 100.0, 0.1)
    bodies = corrected(before.links.bodies, np.linspace(-0.2, 0.2, 10)[None])
    after = fjr.robot_from_urdf(with_inertias(URDF, ["a"], bodies), ["a"], 100.0, 0.1)
    expected = serial_chain(bodies)
    for q in (np.array([0.0]), np.array([0.7])):
        np.testing.assert_allclose(after.M_l(q), expected.M_l(q).full(), rtol=1e-7)
        np.testing.assert_allclose(after.grad_P_l(q), expected.grad_P_l(q).full().ravel(), rtol=1e-7)
    assert after.M_l(np.zeros(1)) != pytest.approx(before.M_l(np.zeros(1)), rel=1e-3)
