# SPDX-License-Identifier: Apache-2.0
"""Two laws of M. W. Spong, "Modeling and control of elastic joint robots", ASME J. Dynamic Systems, Measurement and
Control 109(4), 1987, that invert the dynamics: full feedback linearisation and a singular-perturbation correction.

Full feedback linearisation (also A. De Luca, "Feedforward/feedback laws for the control of flexible robots", ICRA
2000):

    d4q = d4q_d - A_3 (d3q - d3q_d) - A_2 (ddq - ddq_d) - A_1 (dq - dq_d) - A_0 (q - q_d)

and u follows from the inverse dynamics (inverse_dynamics.py) of this motion, with ddq and d3q of the links from the
model. The link error obeys this linear equation exactly. With z = (e, de, dde, d3e) and A' P + P A = -Q for its
companion matrix A, V = z' P z / 2 has dV/dt = -z' Q z / 2. Q = diag(1, w^-2, w^-4, w^-6), w^4n = det A_0.

Computed torque with singular-perturbation correction (the integral manifold of Spong, Khorasani, Kokotovic, IEEE J.
Robotics and Automation 3(4), 1987):

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

FAST_DAMPING = 0.7  # damping ratio of the fast pole pair
FASTEST_POLE = 0.4  # rad per sample


@dataclass(frozen=True, eq=False)
class LinearErrorGains:
    """Coefficients A_0 [1/s^4] .. A_3 [1/s] of the error equation: scalars, (n,) or (n, n)."""

    A_0: ArrayLike
    A_1: ArrayLike
    A_2: ArrayLike
    A_3: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Return A_0 .. A_3 (n, n) and P (4n, 4n); raise GainsError if the error equation is unstable."""
        arrays = {k: checks.matrix(k, getattr(self, k), robot.n, GainsError) for k in ("A_0", "A_1", "A_2", "A_3")}
        A = companion(*arrays.values())
        refuse_growth("A_0 .. A_3 give an error", A)
        from scipy.linalg import solve_continuous_lyapunov  # loaded on use: see law/gains.py

        P = solve_continuous_lyapunov(A.T, -weight(arrays["A_0"]))
        return {**arrays, "P": (P + P.T) / 2}

    @classmethod
    def standard(
        cls, robot: Robot, q_0: Array, omega: float, zeta: float, sample_period: float = 1e-3
    ) -> LinearErrorGains:
        """Return gains with two time scales: (s^2 + 2 zeta omega s + omega^2) (s^2 + 2 zeta_f F s + F^2), zeta_f = 0.7.

        omega [rad/s] and zeta set the bandwidth; F = fast_rates. Four poles at omega would slow the springs down: the
        effort would be M_m K^-1 M_l times the difference of two large numbers, and the zero-order hold would leave a
        large error.
        """
        one = np.eye(robot.n)
        F = fast_rates(robot, q_0, omega, sample_period)
        slow, fast = (omega**2 * one, 2 * zeta * omega * one), (F @ F, 2 * FAST_DAMPING * F)
        return cls(
            A_0=slow[0] @ fast[0],
            A_1=slow[0] @ fast[1] + slow[1] @ fast[0],
            A_2=slow[0] + slow[1] @ fast[1] + fast[0],
            A_3=slow[1] + fast[1],
        )


class FeedbackLinearisation(Baseline):
    """Full feedback linearisation (Spong 1987, De Luca 2000)."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """Return u (n,) [N m] and V."""
        m = f.measured
        (d3q,) = f.d(m.ddq_l)
        motion = [m.q_l, m.dq_l, m.ddq_l, d3q]
        errors = [q - f.jets[:, k] for k, q in enumerate(motion)]
        d4q = f.jets[:, 4] - sum(A @ e for A, e in zip((g.A_0, g.A_1, g.A_2, g.A_3), errors, strict=True))
        z = ca.vertcat(*errors)
        return effort(f.robot, motor_motion(f.robot, *motion, d4q).torque), ca.dot(z, g.P @ z) / 2

    @property
    def hold_damping(self) -> Array:
        """M_m trace(A_3) / n (n, n) [N m s/rad]."""
        return np.asarray(self.robot.M_m * np.trace(self.arrays["A_3"]) / self.robot.n)


def companion(*coefficients: Array) -> Array:
    """Return the companion matrix A (kn, kn), dz = A z, of the coefficients A_0 .. (n, n) of an equation of order k."""
    n = len(coefficients[0])
    return np.vstack([np.eye(len(coefficients) * n)[n:], -np.hstack(coefficients)])


def refuse_growth(what: str, A: Array) -> None:
    """Raise GainsError if dz = A z, which `what` names, does not decay."""
    slowest = float(np.linalg.eigvals(A).real.max())
    if not slowest < 0:
        raise GainsError(f"{what} that grows as exp({slowest:.4g} t); expected one that decays")


def weight(A_0: Array) -> Array:
    """Return the weight Q (4n, 4n) of the Lyapunov equation."""
    w = abs(np.linalg.det(A_0)) ** (1 / (4 * len(A_0)))
    return np.kron(np.diag(w ** -np.array([0.0, 2.0, 4.0, 6.0])), np.eye(len(A_0)))


def fast_rates(robot: Robot, q_0: Array, omega: float, sample_period: float) -> Array:
    """Return F (n, n) [rad/s]: half the elastic frequencies at q_0, between omega and FASTEST_POLE / sample_period.

    The squared frequencies are the eigenvalues of M_l^-1 K (M_m^-1 M_l + 1).
    """
    M_l = robot.M_l(q_0)
    squares, V = np.linalg.eig(np.linalg.solve(M_l, robot.K @ (np.linalg.solve(robot.M_m, M_l) + np.eye(robot.n))))
    rates = np.maximum(np.minimum(np.sqrt(squares.real) / 2, FASTEST_POLE / sample_period), omega)
    return np.asarray((V * rates @ np.linalg.inv(V)).real)


@dataclass(frozen=True, eq=False)
class CompositeGains:
    """Gains K_p [1/s^2], K_v [1/s] (slow subsystem) and K_f [N m s/rad] (fast): scalars, (n,) or (n, n)."""

    K_p: ArrayLike
    K_v: ArrayLike
    K_f: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Return the gains as (n, n); raise GainsError if the slow subsystem is unstable."""
        K_p, K_v = (checks.matrix(k, getattr(self, k), robot.n, GainsError) for k in ("K_p", "K_v"))
        refuse_growth("K_p, K_v give a slow mode", companion(K_p, K_v))
        return {"K_p": K_p, "K_v": K_v, "K_f": damping("K_f", self.K_f, robot.n, robot.D_m)}

    @classmethod
    def standard(
        cls, robot: Robot, q_0: Array, omega: float, zeta: float, _sample_period: float = np.nan
    ) -> CompositeGains:
        """Return gains: critically damped slow subsystem at omega [rad/s], motor modes with damping ratio zeta."""
        return cls(K_p=omega**2, K_v=2 * omega, K_f=zeta * critical_damping(robot.M_m, robot.K) - robot.D_m)


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
