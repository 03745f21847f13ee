# SPDX-License-Identifier: Apache-2.0
"""Guess the stiffness and the motor inertia of joints from the size of each joint; no data of one robot.

    tau   effort limit; without a limit twice the largest gravity torque plus a moderate acceleration
    K   = min(tau / delta, omega_l^2 m)    delta: 1 degree, 1 mm; m: least 1 / (M_l^-1)_ii over the range, the inertia
                                           that joint i feels while the others move freely
    M_m = K / omega_m^2

A degree at the effort limit gives 10^3 to 2 10^4 N m/rad for arms of 20 to 300 N m, the order of harmonic drives with
joint torque sensors. omega_l keeps a joint that carries almost nothing, such as a wrist without a tool, within reach
of a loop at 1 kHz. With omega_m the guess for a joint of 87 N m is 0.61 kg m^2, as the maker publishes for the first
joints of the Franka FR3 (Drake, manipulation/models/franka_description/README.md).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..model.configuration_sampling import sample_configurations
from ..model.robot import Robot
from ..numerics.checks import Array

LARGEST_DEFLECTION = np.deg2rad(1.0), 1e-3  # rad, m; delta of revolute and prismatic joints at the effort limit
FASTEST_LINK = 400.0  # rad/s, omega_l: the least inertia m on its spring, the motor at rest
MOTOR_FREQUENCY = 90.0  # rad/s, omega_m: the motor on its spring, the link at rest
ACCELERATION = 10.0  # rad/s^2, m/s^2
CONFIGURATIONS = 128  # over which inertia and weight are taken
DIGITS = 2  # of a guess
THINNEST = 1e-3  # m; least radius of gyration of real links about their joint; those of public URDFs have 13 mm or more


class TypicalJoints(NamedTuple):
    """Guessed stiffness [N m/rad] and reflected motor inertia [kg m^2], (n,) each; prismatic joints: N/m and kg."""

    stiffness: Array
    motor_inertia: Array


def typical_joints(robot: Robot) -> TypicalJoints:
    """Return guesses for the joints of a rigid arm; the robot's own stiffness and motor inertia are not used."""
    where = sample_configurations(robot, CONFIGURATIONS)
    M_l = np.array([robot.M_l(q_l) for q_l in where])
    deflection = np.array([LARGEST_DEFLECTION[slides] for slides in robot.prismatic or (False,) * robot.n])
    weight = np.max([np.abs(robot.grad_P_l(q_l)) for q_l in where], axis=0)
    needed = 2 * weight + ACCELERATION * np.diag(M_l.mean(axis=0))
    limits = np.full(robot.n, np.inf) if robot.limits is None else robot.limits.effort
    effort = np.where(np.isfinite(limits), limits, needed)
    stiffness = np.minimum(effort / deflection, FASTEST_LINK**2 * least_free_inertia(M_l))
    return TypicalJoints(_rounded(stiffness), _rounded(stiffness / MOTOR_FREQUENCY**2))


def _rounded(values: Array) -> Array:
    """Return the values with two digits: a guess has no more."""
    return np.array([float(f"{value:.{DIGITS}g}") for value in values])


def least_free_inertia(M_l: ArrayLike) -> Array:
    """Return for each joint (n,) the least 1 / (M_l^-1)_ii [kg m^2] over link inertias (k, n, n)."""
    return np.asarray(1 / np.diagonal(np.linalg.inv(np.asarray(M_l)), axis1=1, axis2=2).max(axis=0))


def joints_without_inertia(robot: Robot) -> dict[int, str]:
    """Return a sentence for each revolute joint of a serial chain whose links have no inertia about it, by its number.

    Their radius of gyration is below THINNEST in some configuration: a URDF lacks the inertia, or has a placeholder.
    """
    if not robot.links.bodies:
        return {}
    M_l = np.array([robot.M_l(q_l) for q_l in sample_configurations(robot, CONFIGURATIONS)])
    inertia = np.diagonal(M_l, axis1=1, axis2=2).min(axis=0)
    slides, bodies = robot.prismatic or (False,) * robot.n, robot.links.bodies
    mass = [sum(body.mass for body in bodies[place:]) for place in robot.links.order]
    return {
        i: f"turns {mass[i]:.3g} kg with an inertia of {inertia[i]:.2g} kg m^2, which no real link has"
        for i in range(robot.n)
        if not slides[i] and inertia[i] < mass[i] * THINNEST**2
    }
