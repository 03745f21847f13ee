# SPDX-License-Identifier: Apache-2.0
"""Build robots with closed-form dynamics: the joint of the paper and a planar two-link arm."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import RobotError
from ..numerics import checks
from .planar_arms import PLANAR_TWO_LINK, SINGLE_LINK, SMALLEST_LOAD, STANDARD_GRAVITY, WEIGHTLESS_LENGTH
from .rigid_arm import ArmDynamics, Body, EndEffector, closed_form
from .robot import Robot


def single_link(
    stiffness: ArrayLike = SINGLE_LINK["stiffness"],
    link_inertia: ArrayLike = SINGLE_LINK["link_inertia"],
    gravity_torque: ArrayLike = SINGLE_LINK["gravity_torque"],
    motor_inertia: ArrayLike = SINGLE_LINK["motor_inertia"],
    link_damping: ArrayLike = SINGLE_LINK["link_damping"],
    motor_damping: ArrayLike = SINGLE_LINK["motor_damping"],
    input_gain: ArrayLike = SINGLE_LINK["input_gain"],
) -> Robot:
    """Return the single-link robot of the paper, Table 1; the link hangs straight down at q_l = 0.

    M_l = link_inertia [kg m^2] about the joint, P_l = gravity_torque (1 - cos q_l) [N m]; the other
    parameters as in Robot. Figure 2 of the paper uses stiffness = 3.1 N m/rad. A payload is subject to gravity of
    9.81 m/s^2 in a vertical plane; the x axis of the link frame points along the link. Raises RobotError.
    """
    (inertia,) = checks.positive_vector("link_inertia", link_inertia, 1, RobotError)
    (load,) = checks.vector("gravity_torque", gravity_torque, 1, RobotError)
    M_l = np.array([[inertia]])
    links = closed_form(
        1,
        lambda q_l: ca.SX(M_l),
        lambda q_l: load * (1 - ca.cos(q_l)),
        vertices=(M_l,),
        end_effector=_planar_end_effector((), STANDARD_GRAVITY),
        bodies=(_pendulum(inertia, load),),
    )
    return _robot(links, M_m=motor_inertia, K=stiffness, D_l=link_damping, D_m=motor_damping, B_m=input_gain)


def planar_two_link(
    stiffness: ArrayLike = PLANAR_TWO_LINK["stiffness"],
    link_mass: ArrayLike = PLANAR_TWO_LINK["link_mass"],
    link_length: ArrayLike = PLANAR_TWO_LINK["link_length"],
    link_com: ArrayLike = PLANAR_TWO_LINK["link_com"],
    link_inertia: ArrayLike = PLANAR_TWO_LINK["link_inertia"],
    gravity: ArrayLike = PLANAR_TWO_LINK["gravity"],
    motor_inertia: ArrayLike = PLANAR_TWO_LINK["motor_inertia"],
    link_damping: ArrayLike = PLANAR_TWO_LINK["link_damping"],
    motor_damping: ArrayLike = PLANAR_TWO_LINK["motor_damping"],
    input_gain: ArrayLike = PLANAR_TWO_LINK["input_gain"],
) -> Robot:
    """Return a two-link arm in a vertical plane with relative joint angles; it hangs straight down at q_l = 0.

    link_mass [kg], link_length and link_com (joint to centre of mass) [m], link_inertia about the centre
    of mass [kg m^2], each (2,); gravity [m/s^2]; the other parameters as in Robot. The x axis of the
    second link's frame points along the link. Raises RobotError.
    Equations: M. W. Spong, S. Hutchinson, M. Vidyasagar, Robot Modeling and Control, sec. 7.4.
    """
    m1, m2 = checks.positive_vector("link_mass", link_mass, 2, RobotError)
    l1, _ = checks.positive_vector("link_length", link_length, 2, RobotError)
    c1, c2 = checks.positive_vector("link_com", link_com, 2, RobotError)
    I1, I2 = checks.positive_vector("link_inertia", link_inertia, 2, RobotError)
    (g,) = checks.vector("gravity", gravity, 1, RobotError)
    constant = np.array([[I1 + m1 * c1**2 + m2 * l1**2, 0], [0, 0]]) + (I2 + m2 * c2**2) * np.ones((2, 2))
    coupling = m2 * l1 * c2 * np.array([[2, 1], [1, 0]])

    def potential(q_l: ca.SX) -> ca.SX:
        q_1, q_2 = q_l[0], q_l[1]
        first, second = m1 * c1 + m2 * l1, m2 * c2
        return g * (first * (1 - ca.cos(q_1)) + second * (1 - ca.cos(q_1 + q_2)))

    links = closed_form(
        2,
        lambda q_l: constant + coupling * ca.cos(q_l[1]),
        potential,
        vertices=(constant + coupling, constant - coupling),
        end_effector=_planar_end_effector((l1,), g),
        bodies=(_planar_body(None, m1, c1, I1), _planar_body(l1, m2, c2, I2)),
    )
    return _robot(links, M_m=motor_inertia, K=stiffness, D_l=link_damping, D_m=motor_damping, B_m=input_gain)


def _robot(links: ArmDynamics, **given: ArrayLike) -> Robot:
    """Return the robot of these matrices, each given as a scalar, (n,) or (n, n)."""
    matrices = {name: checks.matrix(name, value, links.n, RobotError) for name, value in given.items()}
    return Robot(links, matrices["M_m"], matrices["K"], matrices["D_l"], matrices["D_m"], matrices["B_m"])


def _planar_end_effector(lengths: tuple[float, ...], gravity: float) -> EndEffector:
    """Return the end-effector frame of an arm in a vertical plane: x along the last link, z normal to the plane.

    lengths [m]: of the links before the last one.
    """
    q_l, r = ca.SX.sym("q_l", len(lengths) + 1), ca.SX.sym("r", 3)
    angles = ca.cumsum(q_l)
    place = ca.vertcat(0, 0, 0)
    for i, length in enumerate(lengths):
        place += length * _along(angles[i])
    across = ca.vertcat(ca.cos(angles[-1]), 0, ca.sin(angles[-1]))
    position = place + r[0] * _along(angles[-1]) + r[1] * across + r[2] * ca.vertcat(0, -1, 0)
    return EndEffector(ca.Function("position", [q_l, r], [position]), np.array([0.0, 0.0, -gravity]))


HANGING = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
"""Frame of the first link at q_l = 0 in that of the base: x down, y forward, z the axis, which points to the left."""


def _pendulum(inertia: float, load: float) -> Body:
    """Return a uniform rod with inertia [kg m^2] about its joint and m g com = load [N m]: inertia = 4/3 m com^2.

    For a zero load the centre of mass is at the joint; for a negative one it is above.
    """
    if abs(load) < SMALLEST_LOAD:
        return _planar_body(None, 12 * inertia / WEIGHTLESS_LENGTH**2, 0.0, inertia)
    com = 0.75 * inertia * STANDARD_GRAVITY / load
    return _planar_body(None, load / (STANDARD_GRAVITY * com), com, inertia / 4)


def _planar_body(joint: float | None, mass: float, com: float, inertia: float) -> Body:
    """Return a link that turns in a vertical plane; joint, com [m]: places of its joint and its centre of mass along x.

    joint: None for the first link. inertia [kg m^2] about an axis normal to the plane; the others do not matter.
    """
    rotation, place = (HANGING, 0.0) if joint is None else (np.eye(3), joint)
    return Body(rotation, (place, 0.0, 0.0), (0.0, 0.0, 1.0), mass, (com, 0.0, 0.0), np.diag([inertia] * 3))


def _along(angle: ca.SX) -> ca.SX:
    """Return the direction of a link at an angle [rad] from straight down; x forward, z up."""
    return ca.vertcat(ca.sin(angle), 0, -ca.cos(angle))
