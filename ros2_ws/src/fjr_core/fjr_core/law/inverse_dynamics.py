# SPDX-License-Identifier: Apache-2.0
"""Compute the inverse dynamics of a flexible-joint robot: motor motion and torque for a given link motion.

The link positions are a flat output (De Luca, 2000, "Feedforward/feedback laws for the control of flexible robots",
ICRA; Spong 1987). The motor motion follows from q .. d4q without integration:

    tau   = M_l ddq + C_l dq + D_l dq + grad P_l         joint (spring) torque
    theta = q + K^-1 tau                                 motor positions
    u     = B_m^-1 (M_m ddtheta + D_m dtheta + tau)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from ..model.robot import Robot
from ..numerics.symbolic import directional


@dataclass(frozen=True)
class MotorMotion:
    """Joint torque tau (n,) [N m], motor motion theta, dtheta, ddtheta (n,), and motor torque B_m u (n,) [N m]."""

    tau: ca.SX
    theta: ca.SX
    dtheta: ca.SX
    ddtheta: ca.SX
    torque: ca.SX


def spring_torque(robot: Robot, q: ca.SX, dq: ca.SX, ddq: ca.SX) -> ca.SX:
    """Return the joint torque tau (n,) [N m] for a link motion: inverse dynamics of the rigid arm."""
    return robot.links.inertial_torque(q, dq, dq, ddq) + robot.D_l @ dq + robot.links.grad_P_l(q)


def motor_motion(robot: Robot, *motion: ca.SX) -> MotorMotion:
    """Return the motor motion for the link motion q, dq, ddq, d3q, d4q, each (n,)."""
    return MotorMotion(*inverse_dynamics(robot)(*motion))


@lru_cache(maxsize=8)
def inverse_dynamics(robot: Robot) -> ca.Function:
    """Return the CasADi function (q, dq, ddq, d3q, d4q) -> the fields of MotorMotion."""
    names = ("q", "dq", "ddq", "d3q", "d4q")
    q, dq, ddq, d3q, d4q = motion = [ca.SX.sym(name, robot.n) for name in names]
    tau = spring_torque(robot, q, dq, ddq)
    dtau = directional(tau, ca.vertcat(q, dq, ddq), ca.vertcat(dq, ddq, d3q))
    ddtau = directional(dtau, ca.vertcat(q, dq, ddq, d3q), ca.vertcat(dq, ddq, d3q, d4q))
    K_inverse = ca.sparsify(ca.DM(np.linalg.inv(robot.K)))
    theta, dtheta, ddtheta = q + K_inverse @ tau, dq + K_inverse @ dtau, ddq + K_inverse @ ddtau
    torque = robot.M_m @ ddtheta + robot.D_m @ dtheta + tau
    return ca.Function("motor_motion", motion, [tau, theta, dtheta, ddtheta, torque])
