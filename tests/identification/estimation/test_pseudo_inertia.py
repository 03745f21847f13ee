# SPDX-License-Identifier: Apache-2.0
"""Corrected links stay physically consistent, start at the robot file's, and are found again from a record."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.model.newton_euler import serial_chain
from fjr_core.model.rigid_body import Body
from fjr_core.model.robot import Robot
from fjr_core.model.urdf_inertia import with_inertias
from fjr_identification.estimation.elastic_arm import ElasticArm, corrected_arm, corrected_body, packed
from fjr_identification.estimation.estimation_problem import Estimation
from fjr_identification.estimation.filtered_fit import filtered_fit
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.parameters import PSEUDO_INERTIA, Options, Prior
from identification.estimation.test_prediction import values

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


def test_links_without_a_correction_are_those_of_the_robot() -> None:
    links, random = serial_chain(BODIES), np.random.default_rng(1)
    arm = corrected_arm(links, np.zeros((2, 10)))
    q, v, a = random.normal(size=(3, 2))
    for found, expected in (
        (arm.M_l(q), links.M_l(q)),
        (arm.P_l(q), links.P_l(q)),
        (arm.grad_P_l(q), links.grad_P_l(q)),
        (arm.grad_T(q, v), links.grad_T(q, v)),
        (arm.inertial_torque(q, v, v, a), links.inertial_torque(q, v, v, a)),
    ):
        np.testing.assert_allclose(ca.DM(found).full(), expected.full(), rtol=1e-7, atol=1e-9)


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
    setup = Estimation([record], nominal, Prior.of(nominal), Options(link_inertia=True))
    motions, start = setup.start()
    z = filtered_fit(setup, motions, setup.coordinates.of_values(start))
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


def test_a_robot_without_bodies_has_no_inertia_to_correct() -> None:
    robot = fjr.planar_two_link()
    silent = np.zeros((500, 2))
    record = MotionRecord("a record", ("a", "b"), 2e-3, silent, silent, silent, np.full_like(silent, np.nan))
    with pytest.raises(fjr.FjrError, match="expected one from a URDF"):
        Estimation([record], robot, Prior.of(robot), Options(link_inertia=True)).start()
