# SPDX-License-Identifier: Apache-2.0
"""Linear-quadratic regulator of the linearised robot about the reference motion.

    u = u_d - F x~,   x~ = (q - q_d, theta - theta_d, dq - dq_d, dtheta - dtheta_d)

u_d and theta_d follow from the inverse dynamics of the reference (inverse_dynamics.py). A, B: the robot linearised
about the equilibrium at one configuration. P solves A' P + P A - P B R^-1 B' P + Q = 0 and F = R^-1 B' P, which
minimises the integral of x~' Q x~ + u~' R u~ for the linear system. V = x~' P x~ / 2 has dV/dt = -(x~' Q x~ + u~' R u~)
/ 2 for small errors about this equilibrium; elsewhere nothing is proven. (Anderson, Moore: Optimal Control, 1990)
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import GainsError
from fjr_core.law.lie_derivative import Flow
from fjr_core.law.linearized import equilibria_at
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import motor_motion
from fjr_core.numerics import checks
from fjr_core.numerics.checks import Array
from fjr_core.stability.linear_controller import plant_in_velocities

from .baseline import Baseline, effort

LARGEST_RATIO = 1e40
"""Largest ratio of the weights Q and R. The solver finds nothing beyond about 1e32 and overflows beyond 1e50."""


@dataclass(frozen=True, eq=False)
class LqrGains:
    """Weights Q (4n, 4n) >= 0 of x~ and R (n, n) > 0 of the effort; configuration (n,) [rad] of the linearisation."""

    Q: ArrayLike
    R: ArrayLike
    configuration: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Return F (n, 4n) and P (4n, 4n); raise GainsError, also if the Riccati equation has no solution."""
        from scipy.linalg import solve_continuous_are  # loaded on use: see law/gains.py

        n = robot.n
        Q = checks.positive_semidefinite("Q", checks.matrix("Q", self.Q, 4 * n, GainsError), GainsError)
        R = checks.positive_definite("R", checks.matrix("R", self.R, n, GainsError), GainsError)
        q_0 = checks.vector("configuration", self.configuration, n, GainsError)
        (A,), (B,) = plant_in_velocities(equilibria_at(robot, q_0[None]))
        refused = GainsError(
            "Q and R give a Riccati equation without a solution; expected Q to weight every mode, "
            "and Q and R of similar magnitude"
        )
        if np.abs(Q).max() > LARGEST_RATIO * np.abs(R).max():
            raise refused
        try:
            P = solve_continuous_are(A, B, Q, R)
        except (np.linalg.LinAlgError, ValueError):
            raise refused from None
        return {"F": np.linalg.solve(R, B.T @ P), "P": (P + P.T) / 2}

    @classmethod
    def standard(cls, robot: Robot, q_0: Array, omega: float, zeta: float, _sample_period: float = np.nan) -> LqrGains:
        """Return weights for the natural frequency omega [rad/s] and the damping ratio zeta at q_0 (n,) [rad].

        Q = diag(M_l, 0, c M_l / omega^2, 0), c = max(0, 4 zeta^2 - 2). R weights by M_l the link motion that an effort
        causes at omega: u = B_m^-1 S e, S = omega^2 (M_l + M_m) + omega^4 M_m K^-1 M_l. A rigid joint has two poles
        with omega and zeta, zeta at least 2^-1/2; a very compliant joint has a fourth-order Butterworth pattern.
        """
        from scipy.linalg import block_diag

        n, M_l, M_m = robot.n, robot.M_l(q_0), robot.M_m
        S = omega**2 * (M_l + M_m) + omega**4 * M_m @ np.linalg.solve(robot.K, M_l)
        moved, none = np.linalg.solve(S, robot.B_m), np.zeros((n, n))
        c = max(0.0, 4 * zeta**2 - 2)
        return cls(block_diag(M_l, none, c / omega**2 * M_l, none), moved.T @ M_l @ moved, q_0)


class Lqr(Baseline):
    """Linear-quadratic regulator about the reference motion."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """Return u (n,) [N m] and V."""
        m, d = f.measured, motor_motion(f.robot, *ca.horzsplit(f.jets))
        x = ca.vertcat(m.q_l - f.jets[:, 0], m.q_m - d.theta, m.dq_l - f.jets[:, 1], m.dq_m - d.dtheta)
        return effort(f.robot, d.torque) - g.F @ x, ca.dot(x, g.P @ x) / 2

    @property
    def hold_damping(self) -> Array:
        """M_m times the mean damping rate of F (n, n) [N m s/rad]."""
        robot, n = self.robot, self.robot.n
        rates = np.linalg.solve(robot.M_m, robot.B_m @ self.arrays["F"][:, 3 * n :])
        return np.asarray(robot.M_m * np.trace(rates) / n)
