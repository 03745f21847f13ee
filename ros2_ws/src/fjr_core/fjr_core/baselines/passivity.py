# SPDX-License-Identifier: Apache-2.0
"""The passivity-based law: R. Lozano, B. Brogliato, IEEE Trans. Automatic Control 37(2), 1992, as in B. Brogliato,
R. Ortega, R. Lozano, "Global tracking controllers for flexible-joint manipulators: a comparative study", Automatica
31(7), 1995.

    theta_d = q_d + K^-1 tau_d (cascade.py)   e_m = theta - theta_d   s_m = de_m + Lambda e_m   dtheta_r = dtheta - s_m
    B_m u   = M_m ddtheta_r + D_m dtheta_r + K (theta_d - q_d) - K_2 s_m

The spring is kept, not cancelled: its energy is that of e_m - e. With D_1 = K_1 + D_l, D_2 = K_2 + D_m and
V = (s' M_l s + s_m' M_m s_m + (e_m - e)' K (e_m - e)) / 2 + Lambda (e' D_1 e + e_m' D_2 e_m)

    dV/dt = -de' D_1 de - Lambda^2 e' D_1 e - de_m' D_2 de_m - Lambda^2 e_m' D_2 e_m - Lambda (e_m - e)' K (e_m - e).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array
from ..flow import Flow
from ..robot import Robot
from .baseline import Baseline, damping, effort, rate
from .cascade import link_stage


@dataclass(frozen=True, eq=False)
class PassivityGains:
    """Lambda [1/s]: a number; K_1, K_2 [N m s/rad]: scalars, (n,) or (n, n)."""

    Lambda: float
    K_1: ArrayLike
    K_2: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Lambda (1,), K_1, K_2 (n, n); raises GainsError."""
        K_1, K_2 = damping("K_1", self.K_1, robot.n, robot.D_l), damping("K_2", self.K_2, robot.n, robot.D_m)
        return {"Lambda": rate("Lambda", self.Lambda), "K_1": K_1, "K_2": K_2}


class PassivityBased(Baseline):
    """The law of this module."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """u and V."""
        robot, m, link = f.robot, f.measured, link_stage(f, g)
        theta_d = f.jets[:, 0] + np.linalg.inv(robot.K) @ link.tau_d
        (dtheta_d,) = f.d(theta_d)
        (ddtheta_d,) = f.d(dtheta_d)
        e_m, de_m = m.q_m - theta_d, m.dq_m - dtheta_d
        s_m = de_m + g.Lambda * e_m
        ddtheta_r, dtheta_r = ddtheta_d - g.Lambda * de_m, m.dq_m - s_m
        torque = robot.M_m @ ddtheta_r + robot.D_m @ dtheta_r + link.tau_d - g.K_2 @ s_m
        stretch, D_1, D_2 = e_m - link.e, g.K_1 + robot.D_l, g.K_2 + robot.D_m
        V = (ca.dot(link.s, f.M_l @ link.s) + ca.dot(s_m, robot.M_m @ s_m) + ca.dot(stretch, robot.K @ stretch)) / 2
        return effort(robot, torque), V + g.Lambda * (ca.dot(link.e, D_1 @ link.e) + ca.dot(e_m, D_2 @ e_m))

    @property
    def hold_damping(self) -> Array:
        """K_2."""
        return self.arrays["K_2"]


def standard(robot: Robot, q_0: Array, omega: float, zeta: float) -> PassivityGains:
    """Lambda = omega [rad/s]; dampings 2 zeta omega of the inertia, that of the links at q_0."""
    K_1, K_2 = (2 * zeta * omega * M - D for M, D in ((robot.M_l(q_0), robot.D_l), (robot.M_m, robot.D_m)))
    return PassivityGains(Lambda=omega, K_1=K_1, K_2=K_2)
