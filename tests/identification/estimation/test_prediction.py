# SPDX-License-Identifier: Apache-2.0
"""The predicted motion is that of SciPy's integrator; its sensitivities are those of differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import PlanarTwoLink
from core.oracles.elastic_joint import ElasticJoint, integrated, multi_sine
from fjr_core.model.newton_euler import serial_chain
from fjr_core.model.rigid_body import Body
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_identification.estimation.elastic_arm import ElasticArm, packed
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.multiple_shooting import Segment, compare
from fjr_identification.estimation.parameters import KINDS, USUAL, Coordinates, Prior, size
from fjr_identification.estimation.shooting import HeldEffort, Shooting

FREE = (
    "joint_stiffness",
    "motor_inertia",
    "link_damping",
    "motor_coulomb_friction",
    "offset",
    "effort_delay",
    "link_skew",
)


def held(u: Array, dt: float, parts: int) -> HeldEffort:
    n = u.shape[1]
    return HeldEffort(u, dt, parts, np.full(2 * n, parts, dtype=np.int32), np.zeros(2 * n))


def values(n: int, **given: float) -> dict[str, Array]:
    zeros = {name: np.zeros(size(name, n)) for name in KINDS}
    return {**zeros, **{name: np.full(n, value) for name, value in given.items()}, **friction_velocities(n)}


def friction_velocities(n: int) -> dict[str, Array]:
    return {"smoothing": np.full(n, 0.01), "stribeck": np.full(n, 0.1)}


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
    errors = []
    for parts in (16, 32):
        found = Shooting(arm, ())(start, held(u[:, None], dt, parts), 0, len(u) - 1, packed(arm, p), p["effort_delay"])
        assert found is not None
        errors.append(np.max(np.abs(found[0][:, :2] - np.column_stack([link, motor]))))
    assert errors[1] < 2e-7
    assert errors[1] < errors[0] / 8


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
    coordinates = Coordinates.of([(name, 0)], parameters(joint), dict.fromkeys(KINDS, np.ones(1)))
    arm = ElasticArm(robot, coordinates.dynamic)
    shooting, signals = Shooting(arm, coordinates.delays), (("q_l", 0), ("q_m", 0))

    def predicted(z: Array) -> Array:
        found = compare(segment, shooting, coordinates, z, np.array([0.2, 0.21, 0.5, 0.4]), signals, np.ones(2))
        assert found is not None
        return found.predicted

    z, step = coordinates.mean, 1e-5 * max(abs(coordinates.mean[0]), 1e-2)
    found = compare(segment, shooting, coordinates, z, np.array([0.2, 0.21, 0.5, 0.4]), signals, np.ones(2))
    assert found is not None
    difference = (predicted(z + step) - predicted(z - step)) / (2 * step)
    residual = -predicted(z)
    assert found.H[4, 4] == pytest.approx(np.sum(difference**2), rel=1e-4)
    assert found.g[4] == pytest.approx(np.sum(difference * residual), rel=1e-4)


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
    coordinates = Coordinates.of([*free, ("effort_delay", 0), ("effort_delay", 2)], p, dict.fromkeys(KINDS, np.ones(3)))
    arm = ElasticArm(robot, coordinates.dynamic)
    shooting, effort = Shooting(arm, coordinates.delays), held(2 * random.standard_normal((30, 3)), dt, 2)
    assert coordinates.delays == (0, 2)
    assert shooting.padded > 8 * shooting.vectors
    x0, z = 0.5 * random.standard_normal(12), np.concatenate([coordinates.mean[:-2], [3.3e-3, 2.6e-3]])
    direction = random.standard_normal(shooting.columns) * np.concatenate([np.ones(33), [1e-3, 1e-3]])

    def moved(step: float) -> tuple[Array, Array]:
        at = coordinates.parameters(z + step * direction[12:])
        found = shooting(x0 + step * direction[:12], effort, 6, 20, packed(arm, at), at["effort_delay"])
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


def test_prior_of_a_robot_holds_its_values_and_those_that_are_given() -> None:
    robot = fjr.planar_two_link()
    prior = Prior.of(robot, {"joint_stiffness": [50.0, 20.0]})
    np.testing.assert_array_equal(prior.values["joint_stiffness"], [50.0, 20.0])
    np.testing.assert_array_equal(prior.values["motor_inertia"], np.diag(robot.M_m))
    with pytest.raises(fjr.FjrError, match="K is not diagonal; expected one number per joint"):
        Prior.of(replace(robot, K=np.array([[40.0, 1.0], [1.0, 25.0]])))
