# SPDX-License-Identifier: Apache-2.0
"""Integrator backstepping: B. Brogliato, R. Ortega, R. Lozano, "Global tracking controllers for flexible-joint
manipulators: a comparative study", Automatica 31(7), 1995.

    theta_d = q + K^-1 tau_d                   e_m = theta - theta_d      s_m = de_m + c_1 e_m + s
    B_m u   = M_m (ddtheta_d - c_1 de_m - ds - c_2 s_m) - K e_m + D_m dtheta + K (theta - q)

The link stage is the law of Slotine and Li. The unit weights of e_m and s_m in the paper are replaced by K and M_m, so
that all terms have consistent units. With c_1 = Lambda and c_2 M_m = K_2 + D_m this is the passivity-based law of the
same paper; for other c_1, c_2 it is not. With
V = (s' M_l s + e_m' K e_m + s_m' M_m s_m) / 2 + Lambda e' (K_1 + D_l) e

    dV/dt = -de' (K_1 + D_l) de - Lambda^2 e' (K_1 + D_l) e - c_1 e_m' K e_m - c_2 s_m' M_m s_m.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.law.lie_derivative import Flow
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array

from .baseline import Baseline, damping, effort, rate


@dataclass(frozen=True, eq=False)
class BacksteppingGains:
    """Gains Lambda, c_1, c_2 [1/s], scalars, and K_1 [N m s/rad], a scalar, (n,) or (n, n)."""

    Lambda: float
    K_1: ArrayLike
    c_1: float
    c_2: float

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Return Lambda, c_1, c_2 (1,) and K_1 (n, n); raise GainsError."""
        rates = {name: rate(name, getattr(self, name)) for name in ("Lambda", "c_1", "c_2")}
        return {**rates, "K_1": damping("K_1", self.K_1, robot.n, robot.D_l)}

    @classmethod
    def standard(
        cls, robot: Robot, q_0: Array, omega: float, zeta: float, _sample_period: float = np.nan
    ) -> BacksteppingGains:
        """Return gains with two link poles at -omega [rad/s] for the inertia at q_0, and motor rates zeta omega."""
        K_1 = omega * robot.M_l(q_0) - robot.D_l
        return cls(Lambda=omega, K_1=K_1, c_1=zeta * omega, c_2=zeta * omega)


class Backstepping(Baseline):
    """Integrator backstepping (Brogliato, Ortega, Lozano 1995)."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """Return u (n,) [N m] and V [J].

        The link stage, with tau_d = M_l ddq_r + C_l dq_r + D_l dq_r + grad P_l - K_1 s and dq_r = dq_d - Lambda e,
        gives M_l ds + (C_l + D_l + K_1) s = tau - tau_d for s = de + Lambda e and the joint torque tau.
        """
        robot, m = f.robot, f.measured
        e, de = m.q_l - f.jets[:, 0], m.dq_l - f.jets[:, 1]
        dq_r, ddq_r = f.jets[:, 1] - g.Lambda * e, f.jets[:, 2] - g.Lambda * de
        s = m.dq_l - dq_r
        tau_d = f.inertial_torque(dq_r, ddq_r) + robot.D_l @ dq_r + robot.links.grad_P_l(m.q_l) - g.K_1 @ s
        theta_d = m.q_l + np.linalg.inv(robot.K) @ tau_d
        dtheta_d, ds = f.d(theta_d, s)
        (ddtheta_d,) = f.d(dtheta_d)
        e_m, de_m = m.q_m - theta_d, m.dq_m - dtheta_d
        s_m = de_m + g.c_1 * e_m + s
        ddtheta = ddtheta_d - g.c_1 * de_m - ds - g.c_2 * s_m
        torque = robot.M_m @ ddtheta - robot.K @ e_m + robot.D_m @ m.dq_m + robot.K @ (m.q_m - m.q_l)
        V = (ca.dot(s, f.M_l @ s) + ca.dot(e_m, robot.K @ e_m) + ca.dot(s_m, robot.M_m @ s_m)) / 2
        return effort(robot, torque), V + g.Lambda * ca.dot(e, (g.K_1 + robot.D_l) @ e)

    @property
    def hold_damping(self) -> Array:
        """M_m (c_1 + c_2) (n, n) [N m s/rad]."""
        return np.asarray(self.robot.M_m * (self.arrays["c_1"] + self.arrays["c_2"]))
