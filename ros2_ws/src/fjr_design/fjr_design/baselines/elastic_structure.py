# SPDX-License-Identifier: Apache-2.0
"""Elastic structure preserving (ESP) control: M. Keppler, D. Lakatos, C. Ott, A. Albu-Schaeffer, "Elastic structure
preserving (ESP) control for compliantly actuated robots", IEEE Trans. Robotics 34(2), 2018.

A new motor coordinate eta replaces theta. In e = q - q_d and eta the loop is again an arm on its springs, with damping
on the links and with springs and dampers between the motors and the reference:

    M_l dde + (C_l + D_l + D) de = K (eta - e)                                                           (1)
    M_m ddeta + (D_m + D_eta) deta + K_eta eta = -K (eta - e)                                            (2)

Equation (1) defines eta, since the springs transmit K (theta - q):

    eta   = theta - q_d - K^-1 n         n = M_l ddq_d + C_l dq_d + D_l dq_d + grad P_l - D de
    B_m u = M_m (ddtheta - ddeta) + D_m (dtheta - deta) + n - K_eta eta - D_eta deta

and the second line follows from (2). theta - eta = q_d + K^-1 n depends on the motion of the links only. With
V = (de' M_l de + deta' M_m deta + (eta - e)' K (eta - e) + eta' K_eta eta) / 2

    dV/dt = -de' (D_l + D) de - deta' (D_m + D_eta) deta          along every reference.

The paper has springs with any characteristic and no friction. D_l and D_m are our addition, and so is the reading that
its second form, ESP+, is the same law here: it differs by a factor dtheta/deta, which is 1 for straight springs.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.law.gains import critical_damping
from fjr_core.law.lie_derivative import Flow
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array

from .baseline import Baseline, damping, effort, metric


@dataclass(frozen=True, eq=False)
class ElasticStructureGains:
    """Link damping D [N m s/rad], motor K_eta [N m/rad] and D_eta [N m s/rad]: scalars, (n,) or (n, n)."""

    D: ArrayLike
    K_eta: ArrayLike
    D_eta: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Return the gains as (n, n); raise GainsError."""
        return {
            "D": damping("D", self.D, robot.n, robot.D_l),
            "K_eta": metric("K_eta", self.K_eta, robot.n),
            "D_eta": damping("D_eta", self.D_eta, robot.n, robot.D_m),
        }

    @classmethod
    def standard(
        cls, robot: Robot, q_0: Array, omega: float, zeta: float, _sample_period: float = np.nan
    ) -> ElasticStructureGains:
        """Return gains with omega [rad/s] at q_0, assuming rigid joints, and damping ratio zeta.

        D damps the links on the springs K and K_eta in series, which limit their frequency.
        """
        M_l = robot.M_l(q_0)
        K_eta = omega**2 * (M_l + robot.M_m)
        series = robot.K @ np.linalg.solve(robot.K + K_eta, K_eta)
        D = zeta * critical_damping(M_l, (series + series.T) / 2) - robot.D_l
        return cls(D, K_eta, 2 * zeta * omega * robot.M_m - robot.D_m)


class ElasticStructurePreserving(Baseline):
    """Elastic structure preserving control (Keppler, Lakatos, Ott, Albu-Schaeffer 2018)."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """Return u (n,) [N m] and V [J]."""
        robot, m, (q_d, dq_d, ddq_d, *_) = f.robot, f.measured, ca.horzsplit(f.jets)
        e, de = m.q_l - q_d, m.dq_l - dq_d
        n = f.inertial_torque(dq_d, ddq_d) + robot.D_l @ dq_d + robot.links.grad_P_l(m.q_l) - g.D @ de
        shift = q_d + np.linalg.inv(robot.K) @ n  # theta - eta
        (dshift,) = f.d(shift)
        (ddshift,) = f.d(dshift)
        eta, deta = m.q_m - shift, m.dq_m - dshift
        torque = robot.M_m @ ddshift + robot.D_m @ dshift + n - g.K_eta @ eta - g.D_eta @ deta
        kinetic = ca.dot(de, f.M_l @ de) + ca.dot(deta, robot.M_m @ deta)
        springs = ca.dot(eta - e, robot.K @ (eta - e)) + ca.dot(eta, g.K_eta @ eta)
        return effort(robot, torque), (kinetic + springs) / 2

    @property
    def hold_damping(self) -> Array:
        """Motor damping gain D_eta (n, n) [N m s/rad]."""
        return self.arrays["D_eta"]
