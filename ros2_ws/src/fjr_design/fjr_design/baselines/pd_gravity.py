# SPDX-License-Identifier: Apache-2.0
"""Motor PD control with gravity compensation, and with feedforward of the reference.

    u = B_m^-1 (tau_ff - K_p (theta - theta_d) - K_d (dtheta - dtheta_d))

PdGravity: P. Tomei, "A simple PD controller for robots with elastic joints", IEEE Trans. Automatic Control 36(10),
1991. tau_ff = grad P_l(q_d), theta_d = q_d + K^-1 grad P_l(q_d). The paper proves regulation only: with a moving
reference, inertia and friction cause a tracking error.

PdFeedforward: A. De Luca, "Feedforward/feedback laws for the control of flexible robots", ICRA 2000. theta_d and
tau_ff = M_m ddtheta_d + D_m dtheta_d + tau_d by the inverse dynamics (inverse_dynamics.py) of the reference; for a
constant reference both laws are equal.

Only motor signals are measured. For a constant reference, q_d is the only equilibrium and
dV/dt = -dq' D_l dq - dtheta' (D_m + K_d) dtheta.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.law.lie_derivative import Flow
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import motor_motion
from fjr_core.numerics.checks import Array

from .baseline import Baseline, damping, effort, metric
from .set_point_storage import check_position_gain, motor_set_point, storage


@dataclass(frozen=True, eq=False)
class PdGains:
    """Motor gains K_p [N m/rad] and K_d [N m s/rad]: scalars, (n,) or (n, n)."""

    K_p: ArrayLike
    K_d: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Return K_p and K_d (n, n); raise GainsError, also if K_p is too small for gravity."""
        K_p = metric("K_p", self.K_p, robot.n)
        check_position_gain("K_p", K_p, robot)
        return {"K_p": K_p, "K_d": damping("K_d", self.K_d, robot.n, robot.D_m)}


class PdGravity(Baseline):
    """Motor PD with gravity compensation (Tomei 1991)."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """Return u (n,) [N m] and V [J], the storage for a constant reference."""
        m, (theta_d, dtheta_d, feedforward) = f.measured, self.reference(f)
        torque = feedforward - g.K_p @ (m.q_m - theta_d) - g.K_d @ (m.dq_m - dtheta_d)
        return effort(f.robot, torque), storage(f, theta_d, dtheta_d, ca.DM(f.robot.M_m), g.K_p)

    def reference(self, f: Flow) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return theta_d [rad], dtheta_d [rad/s] and the feedforward torque [N m], each (n,)."""
        return *motor_set_point(f), f.robot.links.grad_P_l(f.jets[:, 0])

    @property
    def hold_damping(self) -> Array:
        """Motor damping gain K_d (n, n) [N m s/rad]."""
        return self.arrays["K_d"]


class PdFeedforward(PdGravity):
    """Motor PD about the motor reference, with its feedforward torque (De Luca 2000)."""

    def reference(self, f: Flow) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return theta_d [rad], dtheta_d [rad/s] and the torque [N m] of the inverse dynamics, each (n,)."""
        d = motor_motion(f.robot, *ca.horzsplit(f.jets))
        return d.theta, d.dtheta, d.torque


def standard(robot: Robot, q_0: Array, omega: float, zeta: float, _sample_period: float = np.nan) -> PdGains:
    """Return gains with natural frequency omega [rad/s] and damping ratio zeta at q_0, assuming rigid joints."""
    M = robot.M_l(q_0) + robot.M_m
    return PdGains(K_p=omega**2 * M, K_d=2 * zeta * omega * M - robot.D_m)
