# SPDX-License-Identifier: Apache-2.0
"""Computed torque with singular-perturbation correction: M. W. Spong, "Modeling and control of elastic joint robots",
ASME J. Dynamic Systems, Measurement and Control 109(4), 1987; Spong, Khorasani, Kokotovic, IEEE J. Robotics and
Automation 3(4), 1987 (integral manifold).

    slow   ddq = v(q, dq, t) = ddq_d - K_v (dq - dq_d) - K_p (q - q_d), as if the joints were rigid
    u      = the inverse dynamics of that slow flow - B_m^-1 K_f (dtheta - dtheta_s)

q, dq are measured, the higher derivatives are v and its rates along the slow flow; theta_s, dtheta_s are the motors' on
it. What goes beyond the rigid computed torque (M_l + M_m) v + n is of order 1/K: the correction, which makes
theta = theta_s an invariant manifold on which the link error obeys the slow equation exactly. K_f damps the way to it,
so K_f has to make that way fast beside K_p, K_v: with soft joints it does not, and nothing is proven.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ...errors import GainsError
from ...numerics import checks
from ...numerics.checks import Array
from ...robot.robot import Robot
from ..inverse_dynamics import motor_motion
from ..lie_derivative import Flow
from ..vdpbc.gains import critical_damping
from .baseline import Baseline, damping, effort


@dataclass(frozen=True, eq=False)
class CompositeGains:
    """K_p [1/s^2], K_v [1/s] of the slow flow, K_f [N m s/rad] of the fast one: scalars, (n,) or (n, n)."""

    K_p: ArrayLike
    K_v: ArrayLike
    K_f: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """The same (n, n); raises GainsError where the slow flow would not decay."""
        K_p, K_v = (checks.matrix(k, getattr(self, k), robot.n, GainsError) for k in ("K_p", "K_v"))
        slow = np.block([[np.zeros_like(K_p), np.eye(robot.n)], [-K_p, -K_v]])
        slowest = float(np.linalg.eigvals(slow).real.max())
        if not slowest < 0:
            raise GainsError(f"K_p, K_v give a slow flow that grows as exp({slowest:.4g} t); expected one that decays")
        return {"K_p": K_p, "K_v": K_v, "K_f": damping("K_f", self.K_f, robot.n, robot.D_m)}


class SingularPerturbation(Baseline):
    """The law of this module; it has no storage: V is nan."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """u, and nan."""
        m, (q_d, dq_d, ddq_d, d3q_d, d4q_d) = f.measured, ca.horzsplit(f.jets)
        v = ddq_d - g.K_v @ (m.dq_l - dq_d) - g.K_p @ (m.q_l - q_d)
        dv = d3q_d - g.K_v @ (v - ddq_d) - g.K_p @ (m.dq_l - dq_d)
        ddv = d4q_d - g.K_v @ (dv - d3q_d) - g.K_p @ (v - ddq_d)
        slow = motor_motion(f.robot, m.q_l, m.dq_l, v, dv, ddv)
        return effort(f.robot, slow.torque - g.K_f @ (m.dq_m - slow.dtheta)), ca.SX(np.nan)

    @property
    def hold_damping(self) -> Array:
        """K_f."""
        return self.arrays["K_f"]


def standard(robot: Robot, q_0: Array, omega: float, zeta: float, _sample_period: float = np.nan) -> CompositeGains:
    """A critically damped slow flow of omega [rad/s]; motors on their springs have the damping ratio zeta."""
    return CompositeGains(K_p=omega**2, K_v=2 * omega, K_f=zeta * critical_damping(robot.M_m, robot.K) - robot.D_m)
