# SPDX-License-Identifier: Apache-2.0
"""Computed torque with singular-perturbation correction: M. W. Spong, "Modeling and control of elastic joint robots",
ASME J. Dynamic Systems, Measurement and Control 109(4), 1987; Spong, Khorasani, Kokotovic, IEEE J. Robotics and
Automation 3(4), 1987 (integral manifold).

    slow   ddq = v(q, dq, t) = ddq_d - K_v (dq - dq_d) - K_p (q - q_d), as if the joints were rigid
    u      = inverse dynamics (inverse_dynamics.py) of the slow subsystem - B_m^-1 K_f (dtheta - dtheta_s)

q and dq are measured. The higher derivatives are v and its rates along the slow subsystem; theta_s and dtheta_s are its
motor motion. The terms beyond the rigid computed torque (M_l + M_m) v + n are of order 1/K. This correction makes
theta = theta_s an invariant manifold, on which the link error obeys the slow equation exactly. K_f damps the
convergence to the manifold, which must be fast compared with K_p and K_v. With compliant joints it is not, and nothing
is proven.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import GainsError
from fjr_core.law.gains import critical_damping
from fjr_core.law.lie_derivative import Flow
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import motor_motion
from fjr_core.numerics import checks
from fjr_core.numerics.checks import Array

from .baseline import Baseline, damping, effort


@dataclass(frozen=True, eq=False)
class CompositeGains:
    """Gains K_p [1/s^2], K_v [1/s] (slow subsystem) and K_f [N m s/rad] (fast): scalars, (n,) or (n, n)."""

    K_p: ArrayLike
    K_v: ArrayLike
    K_f: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Return the gains as (n, n); raise GainsError if the slow subsystem is unstable."""
        K_p, K_v = (checks.matrix(k, getattr(self, k), robot.n, GainsError) for k in ("K_p", "K_v"))
        slow = np.block([[np.zeros_like(K_p), np.eye(robot.n)], [-K_p, -K_v]])
        slowest = float(np.linalg.eigvals(slow).real.max())
        if not slowest < 0:
            raise GainsError(f"K_p, K_v give a slow mode that grows as exp({slowest:.4g} t); expected one that decays")
        return {"K_p": K_p, "K_v": K_v, "K_f": damping("K_f", self.K_f, robot.n, robot.D_m)}


class SingularPerturbation(Baseline):
    """Computed torque with singular-perturbation correction (Spong 1987); V is nan, the law has no storage."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """Return u (n,) [N m], and nan for V."""
        m, (q_d, dq_d, ddq_d, d3q_d, d4q_d) = f.measured, ca.horzsplit(f.jets)
        v = ddq_d - g.K_v @ (m.dq_l - dq_d) - g.K_p @ (m.q_l - q_d)
        dv = d3q_d - g.K_v @ (v - ddq_d) - g.K_p @ (m.dq_l - dq_d)
        ddv = d4q_d - g.K_v @ (dv - d3q_d) - g.K_p @ (v - ddq_d)
        slow = motor_motion(f.robot, m.q_l, m.dq_l, v, dv, ddv)
        return effort(f.robot, slow.torque - g.K_f @ (m.dq_m - slow.dtheta)), ca.SX(np.nan)

    @property
    def hold_damping(self) -> Array:
        """Motor damping gain K_f (n, n) [N m s/rad]."""
        return self.arrays["K_f"]


def standard(robot: Robot, q_0: Array, omega: float, zeta: float, _sample_period: float = np.nan) -> CompositeGains:
    """Return gains: critically damped slow subsystem at omega [rad/s], motor modes with damping ratio zeta."""
    return CompositeGains(K_p=omega**2, K_v=2 * omega, K_f=zeta * critical_damping(robot.M_m, robot.K) - robot.D_m)
