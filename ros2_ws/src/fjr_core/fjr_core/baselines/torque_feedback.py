# SPDX-License-Identifier: Apache-2.0
"""Full state feedback with torque feedback: A. Albu-Schaeffer, C. Ott, G. Hirzinger, "A unified passivity-based
control framework for position, torque and impedance control of flexible joint robots", Int. J. Robotics Research
26(1), 2007.

    B_m u = M_m M_theta^-1 (w - tau - D_m dtheta) + tau + D_m dtheta,  so that M_theta ddtheta + D_m dtheta + tau = w
    w     = M_theta ddtheta_d + D_m dtheta_d + tau_d - K_theta (theta - theta_d) - D_theta (dtheta - dtheta_d)

The torque feedback makes the motors' apparent inertia M_theta smaller than M_m. The paper regulates: where the
reference stands, w is its weight grad P_l(q_d) and dV/dt = -dq' D_l dq - dtheta' (D_m + D_theta) dtheta. What a moving
reference adds is the inverse dynamics of the reference alone (inverse.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array
from ..errors import GainsError
from ..flow import Flow
from ..gains import relative_eigenvalues
from ..robot import Robot
from .baseline import Baseline, damping, effort, metric
from .inverse import motor_motion
from .standing import check_position_gain, storage


@dataclass(frozen=True, eq=False)
class TorqueFeedbackGains:
    """M_theta [kg m^2] apparent motor inertia, K_theta [N m/rad], D_theta [N m s/rad]: scalars, (n,) or (n, n)."""

    M_theta: ArrayLike
    K_theta: ArrayLike
    D_theta: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """M_theta with its inverse, K_theta, D_theta (n, n); raises GainsError, also where M_theta is above M_m."""
        M_theta, K_theta = metric("M_theta", self.M_theta, robot.n), metric("K_theta", self.K_theta, robot.n)
        largest = float(relative_eigenvalues(M_theta, robot.M_m)[-1])
        if largest > 1 + 1e-9:
            raise GainsError(f"M_theta is {largest:.4g} times M_m; expected at most 1: torque feedback reduces inertia")
        check_position_gain("K_theta", K_theta, robot)
        D_theta = damping("D_theta", self.D_theta, robot.n, robot.D_m)
        return {
            "M_theta": M_theta,
            "M_theta_inverse": np.asarray(np.linalg.inv(M_theta), dtype=float),
            "K_theta": K_theta,
            "D_theta": D_theta,
        }


class TorqueFeedback(Baseline):
    """The law of this module."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """u and V, the storage for a standing reference."""
        robot, m = f.robot, f.measured
        d = motor_motion(robot, *ca.horzsplit(f.jets))
        w = g.M_theta @ d.ddtheta + robot.D_m @ d.dtheta + d.tau
        w -= g.K_theta @ (m.q_m - d.theta) + g.D_theta @ (m.dq_m - d.dtheta)
        inner = robot.K @ (m.q_m - m.q_l) + robot.D_m @ m.dq_m
        torque = robot.M_m @ (g.M_theta_inverse @ (w - inner)) + inner
        return effort(robot, torque), storage(f, d.theta, d.dtheta, g.M_theta, g.K_theta)

    @property
    def hold_damping(self) -> Array:
        """D_theta."""
        return self.arrays["D_theta"]


def standard(robot: Robot, q_0: Array, omega: float, zeta: float) -> TorqueFeedbackGains:
    """Half the motors' inertia; were the joints rigid, omega [rad/s] and the damping ratio zeta at q_0."""
    M = robot.M_l(q_0) + robot.M_m / 2
    return TorqueFeedbackGains(robot.M_m / 2, omega**2 * M, 2 * zeta * omega * M - robot.D_m)
