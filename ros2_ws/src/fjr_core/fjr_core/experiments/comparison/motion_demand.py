# SPDX-License-Identifier: Apache-2.0
"""What a motion is in numbers, whatever law is to follow it: its size, and the torque that it takes."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ...errors import CompareError
from ...numerics.checks import Array
from ...robot.robot import Robot
from ...simulation.nonideal_parameters import Imperfections, friction_rate
from ...trajectories.reference import Reference

INSTANTS = 4096
CONFIGURATIONS = 16
HORIZON = 60.0  # s of the reference that are looked at, or until it ends
STANDING = 1e-9  # rad


@dataclass(frozen=True)
class Needs:
    """motion [rad]: RMS of q_ld about its mean, over time and joints.

    torque (n,) [N m]: RMS over time of M_l ddq_ld + C dq_ld + D_l dq_ld + grad P_l, what the rigid arm takes along the
    reference. friction_rate [rad/s^2]: the fastest rate of imperfections.friction_rate with friction of that torque on
    both sides, times its smoothing.
    """

    motion: float
    torque: Array
    friction_rate: float


def needs(robot: Robot, reference: Reference) -> Needs:
    """The needs of a reference; raises CompareError for one that stands still."""
    end = min(HORIZON, reference.end)
    jets = reference.jets(np.linspace(0.0, end, INSTANTS))
    position = jets[:, 0]
    motion = float(np.sqrt(np.mean((position - position.mean(axis=0)) ** 2)))
    if not motion > STANDING:
        raise CompareError(f"the reference stands still for {end:g} s; expected one that moves")
    inverse = _inverse_dynamics(robot)
    torques = inverse.map(INSTANTS)(*(jets[:, row].T for row in range(3))).full()
    torque = np.sqrt(np.mean(torques**2, axis=1))
    friction = Imperfections(robot.n, coulomb_l=torque, coulomb_m=torque, smoothing=1.0)
    rates = [friction_rate(friction, robot.M_l(q_l), robot.M_m) for q_l in position[:: INSTANTS // CONFIGURATIONS]]
    return Needs(motion, torque, max(rates))


def _inverse_dynamics(robot: Robot) -> ca.Function:
    links = robot.links
    q_l, dq_l, ddq_l = (ca.SX.sym(name, robot.n) for name in ("q_l", "dq_l", "ddq_l"))
    torque = links.M_l(q_l) @ ddq_l + links.C(q_l, dq_l, dq_l) + ca.DM(robot.D_l) @ dq_l + links.grad_P_l(q_l)
    return ca.Function("inverse_dynamics", [q_l, dq_l, ddq_l], [ca.densify(torque)])
