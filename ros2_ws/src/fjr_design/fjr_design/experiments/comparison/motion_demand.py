# SPDX-License-Identifier: Apache-2.0
"""Compute the demand of a motion, independent of the law: its amplitude and the torque that it requires."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from fjr_core.errors import CompareError
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import spring_torque
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_core.simulation.imperfections import Imperfections, friction_rate

INSTANTS = 4096
CONFIGURATIONS = 16
HORIZON = 60.0  # s of the reference that are evaluated, at most
STANDING = 1e-9  # rad; RMS of a reference at rest


@dataclass(frozen=True)
class MotionDemand:
    """Demand of a motion.

    motion [rad]: RMS of q_ld about its mean, over time and joints. torque (n,) [N m]: RMS over time of the inverse
    dynamics of the rigid arm, M_l ddq_ld + C dq_ld + D_l dq_ld + grad P_l. friction_rate [rad/s^2]: largest
    imperfections.friction_rate with friction of that torque on both sides, times its smoothing.
    """

    motion: float
    torque: Array
    friction_rate: float


def motion_demand(robot: Robot, reference: Reference) -> MotionDemand:
    """Return the demand of a reference; raises CompareError for a reference at rest."""
    end = min(HORIZON, reference.end)
    jets = reference.jets(np.linspace(0.0, end, INSTANTS))
    position = jets[:, 0]
    motion = float(np.sqrt(np.mean((position - position.mean(axis=0)) ** 2)))
    if not motion > STANDING:
        raise CompareError(f"the reference is at rest for {end:g} s; expected a motion")
    torques = _inverse_dynamics(robot).map(INSTANTS)(*(jets[:, row].T for row in range(3))).full()
    torque = np.sqrt(np.mean(torques**2, axis=1))
    friction = Imperfections(robot.n, coulomb_l=torque, coulomb_m=torque, smoothing=1.0)
    rates = [friction_rate(friction, robot.M_l(q_l), robot.M_m) for q_l in position[:: INSTANTS // CONFIGURATIONS]]
    return MotionDemand(motion, torque, max(rates))


def _inverse_dynamics(robot: Robot) -> ca.Function:
    motion = [ca.SX.sym(name, robot.n) for name in ("q_l", "dq_l", "ddq_l")]
    return ca.Function("inverse_dynamics", motion, [ca.densify(spring_torque(robot, *motion))])
