# SPDX-License-Identifier: Apache-2.0
"""Linear-quadratic regulator on the linearisation, about the reference's own motion.

    u = u_d - F x~,   x~ = (q - q_d, theta - theta_d, dq - dq_d, dtheta - dtheta_d)

u_d, theta_d by the inverse dynamics of the reference. A, B: the robot linearised at rest at one
configuration; P solves A' P + P A - P B R^-1 B' P + Q = 0, F = R^-1 B' P, the least of the integral of
x~' Q x~ + u~' R u~ for the linear system. V = x~' P x~ / 2 has dV/dt = -(x~' Q x~ + u~' R u~) / 2 there, for small
errors about that configuration at rest; away from it nothing is proven.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, solve_continuous_are

from ...errors import GainsError
from ...numerics import checks
from ...numerics.checks import Array
from ...robot.equilibrium import RestPoints, plant_matrices, rest_points
from ...robot.robot import Robot
from ..inverse_dynamics import motor_motion
from ..lie_derivative import Flow
from .baseline import Baseline, effort


@dataclass(frozen=True, eq=False)
class LqrGains:
    """Weights Q (4n, 4n) of x~, semidefinite, and R (n, n) of the effort, definite; configuration (n,) [rad]."""

    Q: ArrayLike
    R: ArrayLike
    configuration: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """F (n, 4n) and P (4n, 4n); raises GainsError, also where the Riccati equation has no solution."""
        n = robot.n
        Q = checks.positive_semidefinite("Q", checks.matrix("Q", self.Q, 4 * n, GainsError), GainsError)
        R = checks.positive_definite("R", checks.matrix("R", self.R, n, GainsError), GainsError)
        A, B = velocity_matrices(robot, checks.vector("configuration", self.configuration, n, GainsError))
        try:
            P = solve_continuous_are(A, B, Q, R)
        except (np.linalg.LinAlgError, ValueError):
            raise GainsError(
                "Q and R give a Riccati equation without a solution; expected Q to see every mode, both of like size"
            ) from None
        return {"F": np.linalg.solve(R, B.T @ P), "P": (P + P.T) / 2}


class Lqr(Baseline):
    """The law of this module."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """u and V."""
        m, d = f.measured, motor_motion(f.robot, *ca.horzsplit(f.jets))
        x = ca.vertcat(m.q_l - f.jets[:, 0], m.q_m - d.theta, m.dq_l - f.jets[:, 1], m.dq_m - d.dtheta)
        return effort(f.robot, d.torque) - g.F @ x, ca.dot(x, g.P @ x) / 2

    @property
    def hold_damping(self) -> Array:
        """The motors' inertia times their mean damping rate in F."""
        robot, n = self.robot, self.robot.n
        rates = np.linalg.solve(robot.M_m, robot.B_m @ self.arrays["F"][:, 3 * n :])
        return np.asarray(robot.M_m * np.trace(rates) / n)


def velocity_matrices(robot: Robot, q_0: Array) -> tuple[Array, Array]:
    """A (4n, 4n), B (4n, n) of the robot about rest at q_0 (n,), in (q, theta, dq, dtheta)."""
    rest = rest_points(robot, q_0[None])
    A, B = plant_matrices(rest)
    T = to_velocities(rest)
    return (T @ A @ np.linalg.inv(T))[0], (T @ B)[0]


def to_velocities(rest: RestPoints) -> Array:
    """T (k, 4n, 4n): (q, theta, dq, dtheta) = T x."""
    one = np.eye(rest.robot.n)
    inverses = np.linalg.inv(rest.M_l), np.linalg.inv(rest.robot.M_m)
    return rest.blocks([one, 0, 0, 0], [0, one, 0, 0], [0, 0, inverses[0], 0], [0, 0, 0, inverses[1]])


def standard(robot: Robot, q_0: Array, omega: float, zeta: float, _sample_period: float = np.nan) -> LqrGains:
    """Link errors and, where zeta asks for it, their rates weighted by the inertia at q_0; efforts by what omega costs.

    Q = diag(M_l, 0, c M_l / omega^2, 0), c = 4 zeta^2 - 2;  R weighs with M_l the motion that an effort makes at omega,
    u = B_m^-1 S e, S = omega^2 (M_l + M_m) + omega^4 M_m K^-1 M_l. A rigid joint gets two poles of natural frequency
    omega [rad/s] and damping ratio zeta, at least 2^-1/2; a very soft one Butterworth's four.
    """
    n, M_l, M_m = robot.n, robot.M_l(q_0), robot.M_m
    S = omega**2 * (M_l + M_m) + omega**4 * M_m @ np.linalg.solve(robot.K, M_l)
    moved, none = np.linalg.solve(S, robot.B_m), np.zeros((n, n))
    c = max(0.0, 4 * zeta**2 - 2)
    return LqrGains(block_diag(M_l, none, c / omega**2 * M_l, none), moved.T @ M_l @ moved, q_0)
