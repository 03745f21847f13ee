# SPDX-License-Identifier: Apache-2.0
"""Equations of uncertain robots against robots that are built with the changed numbers."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.errors import ParameterError
from fjr_core.model.newton_euler import serial_chain
from fjr_core.model.rigid_arm import PayloadArm
from fjr_core.model.robot import Robot
from fjr_proofs.error_bound.deviation_model import DeviationModel
from fjr_proofs.error_bound.uncertain_robot import UncertainRobot
from proofs.error_bound.test_error_bound import two_link

ARM = fjr.planar_two_link()
Q, DQ, DDQ = np.random.default_rng(5).uniform(-1, 1, (3, 2))


def links_of(robot: Robot) -> list[np.ndarray]:
    """Return torque (n,) and inertia (n, n) of the links of a robot at one motion."""
    torque = robot.links.inertial_torque(Q, DQ, DQ, DDQ) + robot.links.grad_P_l(Q)
    return [torque.full().ravel(), robot.M_l(Q)]


def uncertain(errors: dict[str, object], shares: list[float], place: object = (0.0, 0.0, 0.0)) -> list[np.ndarray]:
    torque, M = UncertainRobot(ARM, errors, place).links(Q, DQ, DDQ, shares)
    return [torque.full().ravel(), M.full()]


def check(found: list[np.ndarray], expected: list[np.ndarray]) -> None:
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def test_without_a_share_the_links_are_those_of_the_model() -> None:
    none = {"link_mass": 0.2, "link_central_inertia": 0.1, "gravity_direction": 0.1}
    check(uncertain(none, [0.0] * 6), links_of(ARM))


def test_factors_of_mass_and_inertia_are_those_of_an_arm_with_changed_links() -> None:
    changed = fjr.planar_two_link(
        link_mass=(1.2 * 1.2, 0.8 * 0.8), link_inertia=(0.010 * 1.2 * 0.9, 0.005 * 0.8 * 1.05)
    )
    errors = {"link_mass": 0.2, "link_central_inertia": [0.1, 0.1]}
    check(uncertain(errors, [1.0, -1.0, -1.0, 0.5]), links_of(changed))


def test_a_payload_is_a_point_mass_at_its_place() -> None:
    place = np.array([0.2, 0.03, 0.01])
    found = uncertain({"payload_mass": 0.4, "payload_position": 0.02}, [0.5, 1.0, -1.0, 0.0], place)
    loaded = PayloadArm(ARM.links, ARM.links.end_effector, 0.3, place + [0.02, -0.02, 0.0])
    q = ca.SX.sym("q", 2)
    M, P = ca.Function("M", [q], [loaded.M_l(q)]), ca.Function("P", [q], [loaded.P_l(q)])
    lagrange = ca.Function("T", [q, v := ca.SX.sym("v", 2)], [v.T @ loaded.M_l(q) @ v / 2])
    momentum = ca.Function("p", [q, v], [ca.gradient(lagrange(q, v), v), ca.gradient(lagrange(q, v) - P(q), q)])
    step = 1e-6
    (after, _), (before, _) = (momentum(Q + h * DQ + h**2 / 2 * DDQ, DQ + h * DDQ) for h in (step, -step))
    torque = (after - before) / (2 * step) - momentum(Q, DQ)[1]
    assert found[0] == pytest.approx(torque.full().ravel(), rel=1e-6)
    assert found[1] == pytest.approx(M(Q).full(), rel=1e-12)


def test_gravity_turns_about_two_axes_normal_to_it() -> None:
    """In the plane of the arm gravity turns to either side, or it leaves the plane and loses its cosine there."""
    angle = 0.1
    without = ARM.links.inertial_torque(Q, DQ, DQ, DDQ).full().ravel()
    possible = [(np.sin(angle), np.cos(angle)), (-np.sin(angle), np.cos(angle)), (0.0, np.cos(angle))]
    arms = [serial_chain(ARM.links.bodies, (-9.81 * across, 0.0, -9.81 * down)) for across, down in possible]
    weights = np.array([arm.grad_P_l(Q).full().ravel() for arm in arms])
    found = [uncertain({"gravity_direction": angle}, shares)[0] - without for shares in ([1.0, 0.0], [0.0, 1.0])]
    apart = [np.abs(weights - weight).max(axis=1) for weight in found]
    assert np.max(np.min(apart, axis=1)) < 1e-9
    assert sum(int(np.argmin(each) == 2) for each in apart) == 1


def test_the_shares_of_the_model_itself_are_its_values() -> None:
    found = UncertainRobot(ARM, {"payload": 0.3, "payload_mass": 1.0, "motor_inertia": [0.2, 0.0]})
    np.testing.assert_allclose(found.of_joints("payload", found.nominal), 1.0)
    np.testing.assert_allclose(found.of_joints("payload_mass", found.nominal), 0.0, atol=1e-15)
    np.testing.assert_allclose(found.of_joints("motor_inertia", found.nominal), 1.0)
    np.testing.assert_allclose(found.of_joints("motor_inertia", -np.ones(3)), [1.2, 1.0])
    np.testing.assert_allclose(found.of_joints("motor_inertia", np.ones(3)), [0.8, 1.0])


def test_forces_vanish_on_the_centre_motion_of_every_robot() -> None:
    """The slopes are those of forces that vanish there: their integral to another robot is the force of that robot."""
    errors = {"link_mass": 0.2, "stiffness": 0.1, "payload": 0.1, "motor_inertia": 0.1}
    model, rng = DeviationModel(two_link(), UncertainRobot(ARM, errors)), np.random.default_rng(2)
    path, c, z = rng.uniform(-1, 1, (2, 6)), rng.uniform(-1, 1, 7), 0.1 * rng.uniform(-1, 1, 8)
    motors = model.motors(path, c).full()
    f, points = rng.uniform(-1, 1, 7), np.polynomial.legendre.leggauss(12)
    force = sum(
        w / 2 * model.slopes(path, motors, (1 + x) / 2 * z, c, c + (1 + x) / 2 * (f - c))[0].full()
        for x, w in zip(*points, strict=True)
    ) @ np.concatenate([z, f - c])
    q, zeta, dq, dq_m = np.split(z + np.concatenate([path[:, 0], motors[:, 0], path[:, 1], motors[:, 1]]), 4)
    robot, own = model.uncertain, model.robot
    p, of_motors, of_springs = (robot.of_joints(name, f) for name in ("payload", "motor_inertia", "stiffness"))
    links = (of_springs * (own.K @ zeta) - own.D_l @ dq) / p - robot.links(q, dq, path[:, 2], f)[0].full().ravel()
    assert force[:2] + force[4:] / robot.of_joints("payload", c) == pytest.approx(links, abs=1e-9)
    u = own.B_m @ model.states(path, c)[1].full().ravel()
    pull = (u - of_springs * (own.K @ zeta) - own.D_m @ dq_m) / of_motors - own.M_m @ motors[:, 2]
    assert force[2:4] - force[4:] / robot.of_joints("motor_inertia", c) == pytest.approx(pull, abs=1e-9)


@pytest.mark.parametrize(
    ("changed", "errors", "words"),
    [
        ({"K": np.array([[40.0, 1.0], [1.0, 25.0]])}, {"stiffness": 0.1}, "K that is not"),
        ({"links": replace(ARM.links, bodies=())}, {"link_mass": 0.1}, "an arm without bodies"),
        ({"links": replace(ARM.links, end_effector=None)}, {"payload_mass": 0.1}, "an arm without an end effector"),
    ],
)
def test_errors_that_a_robot_cannot_have_are_refused(
    changed: dict[str, object], errors: dict[str, float], words: str
) -> None:
    with pytest.raises(ParameterError, match=words):
        UncertainRobot(replace(ARM, **changed), errors)


def test_factors_are_in_the_order_of_the_joints_of_the_robot() -> None:
    changed = fjr.planar_two_link(link_mass=(1.2 * 1.1, 0.8), link_inertia=(0.011, 0.005))
    gravity = (0.0, 0.0, -9.81)
    swapped, expected = (
        replace(robot, links=serial_chain(robot.links.bodies, gravity, (1, 0))) for robot in (ARM, changed)
    )
    torque, M = UncertainRobot(swapped, {"link_mass": [0.0, 0.1]}).links(Q, DQ, DDQ, [1.0])
    check([torque.full().ravel(), M.full()], links_of(expected))


def test_without_gravity_its_direction_changes_nothing() -> None:
    links = serial_chain(ARM.links.bodies, (0.0, 0.0, 0.0))
    torque, _ = UncertainRobot(replace(ARM, links=links), {"gravity_direction": 0.1}).links(Q, DQ, DDQ, [1.0, -1.0])
    assert torque.full().ravel() == pytest.approx(links.inertial_torque(Q, DQ, DQ, DDQ).full().ravel(), rel=1e-12)
