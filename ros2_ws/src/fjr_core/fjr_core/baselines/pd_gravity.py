# SPDX-License-Identifier: Apache-2.0
"""Motor PD with gravity compensation: P. Tomei, "A simple PD controller for robots with elastic joints",
IEEE Trans. Automatic Control 36(10), 1991.

    u = B_m^-1 (grad P_l(q_d) - K_p (theta - theta_d) - K_d (dtheta - dtheta_d)),   theta_d = q_d + K^-1 grad P_l(q_d)

Only the motors are measured. Where the reference stands, q_d is the only rest and
dV/dt = -dq' D_l dq - dtheta' (D_m + K_d) dtheta; the paper proves no more, and a moving reference leaves an error.
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
from .baseline import Baseline, damping, effort, metric
from .standing import check_position_gain, storage


@dataclass(frozen=True, eq=False)
class PdGains:
    """K_p [N m/rad] and K_d [N m s/rad] of the motors: scalars, (n,) or (n, n)."""

    K_p: ArrayLike
    K_d: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """K_p, K_d (n, n); raises GainsError, also where K_p is too small for gravity."""
        K_p = metric("K_p", self.K_p, robot.n)
        check_position_gain("K_p", K_p, robot)
        return {"K_p": K_p, "K_d": damping("K_d", self.K_d, robot.n, robot.D_m)}


class PdGravity(Baseline):
    """The law of this module."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """u and V, the storage for a standing reference."""
        robot, m, q_d = f.robot, f.measured, f.jets[:, 0]
        weight = robot.links.grad_P_l(q_d)
        theta_d = q_d + np.linalg.inv(robot.K) @ weight
        (dtheta_d,) = f.d(theta_d)
        torque = weight - g.K_p @ (m.q_m - theta_d) - g.K_d @ (m.dq_m - dtheta_d)
        return effort(robot, torque), storage(f, theta_d, dtheta_d, ca.DM(robot.M_m), g.K_p)

    @property
    def hold_damping(self) -> Array:
        """K_d."""
        return self.arrays["K_d"]


def standard(robot: Robot, q_0: Array, omega: float, zeta: float) -> PdGains:
    """Were the joints rigid, natural frequency omega [rad/s] and damping ratio zeta at q_0."""
    M = robot.M_l(q_0) + robot.M_m
    return PdGains(K_p=omega**2 * M, K_d=2 * zeta * omega * M - robot.D_m)
