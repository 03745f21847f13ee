# SPDX-License-Identifier: Apache-2.0
"""Active disturbance rejection control (ADRC): J. Han, "From PID to active disturbance rejection control", IEEE Trans.
Industrial Electronics 56(3), 2009, with gains by bandwidth: Z. Gao, "Scaling and bandwidth-parameterization based
controller tuning", ACC 2003. For an elastic joint as a chain of four integrators: S. E. Talole, J. P. Kolhe, S. B.
Phadke, "Extended-state-observer-based control of flexible-joint system with experimental validation", IEEE Trans.
Industrial Electronics 57(4), 2010.

About the feedforward motion (inverse_dynamics.py), e = q - q_d and e_m = theta - theta_d obey, with tau = K (e_m - e),

    M dde = tau + M d          M_m dde_m = B_m (u - u_d) - tau + M_m d_m                                  (1)

M is the inertia of the links at one configuration; d and d_m are all that (1) lacks. A linear extended state observer
of each joint and side estimates z = (e, de, d) and (e_m, de_m, d_m) from the measured position alone, its three poles
at -bandwidth. The chain a = dde, j = d3e follows from the estimates with d constant, and

    a = M^-1 tau + d           j = M^-1 K (de_m - de)
    B_m (u - u_d) = tau - M_m d_m + M_m (a + K^-1 M v),   v = -A_3 j - A_2 a - A_1 de - A_0 e             (2)

gives d4e = v, but for the rates of d. Talole et al. observe the whole chain from q alone. Two observers, one for each
encoder, are our reading for a robot that measures both sides, and so is the feedforward (error-based ADRC).

The observer is a current estimator (R. Miklosovic, A. Radke, Z. Gao, "Discrete implementation and generalization of the
extended state observer", ACC 2006): prediction over dt, then a correction with its poles at b = exp(-bandwidth dt).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.law.lie_derivative import Flow
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import MotorMotion, motor_motion
from fjr_core.numerics.checks import Array

from .baseline import ObservedBaseline, effort, metric, rate
from .feedback_linearisation import LinearErrorGains, fast_rates

FASTER = 3.0  # ratio of the observer's bandwidth to the fastest pole of the chain (Gao 2003: 3 to 5)
FASTEST_OBSERVER = 1.0  # rad per sample


@dataclass(frozen=True, eq=False)
class ActiveDisturbanceGains(LinearErrorGains):
    """Coefficients of LinearErrorGains, the link inertia M [kg m^2] and the bandwidth [rad/s] of the observers."""

    M: ArrayLike
    bandwidth: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Return A_0 .. A_3 and M (n, n) and the bandwidth (1,); raise GainsError."""
        chain = {name: array for name, array in super().arrays(robot).items() if name != "P"}
        return {**chain, "M": metric("M", self.M, robot.n), "bandwidth": rate("bandwidth", self.bandwidth)}

    @classmethod
    def standard(
        cls, robot: Robot, q_0: Array, omega: float, zeta: float, sample_period: float = 1e-3
    ) -> ActiveDisturbanceGains:
        """Return the coefficients of LinearErrorGains.standard and an observer FASTER times as fast as their poles."""
        chain = LinearErrorGains.standard(robot, q_0, omega, zeta, sample_period)
        fastest = float(np.linalg.eigvals(fast_rates(robot, q_0, omega, sample_period)).real.max())
        bandwidth = min(FASTER * fastest, FASTEST_OBSERVER / sample_period)
        return cls(chain.A_0, chain.A_1, chain.A_2, chain.A_3, robot.M_l(q_0), bandwidth)


class ActiveDisturbanceRejection(ObservedBaseline):
    """Active disturbance rejection about the feedforward motion (Han 2009, Gao 2003); V is nan, it has no storage."""

    observes = "all that the chain of integrators lacks"

    @property
    def memory_sizes(self) -> dict[str, int]:  # type: ignore[override]
        """Estimates z of links and motors; accelerations known at the last sample."""
        return dict.fromkeys(("e", "de", "d", "known"), 2 * self.robot.n)

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """Return u (n,) [N m] with the disturbances of the exact model, and nan for V."""
        robot, m, reference = f.robot, f.measured, motor_motion(f.robot, *ca.horzsplit(f.jets))
        e = ca.vertcat(m.q_l - f.jets[:, 0], m.q_m - reference.theta)
        de = ca.vertcat(m.dq_l - f.jets[:, 1], m.dq_m - reference.dtheta)
        links = m.ddq_l - f.jets[:, 2] - ca.solve(g.M, self._tau(e))
        motors = -np.linalg.solve(robot.M_m, robot.D_m) @ de[robot.n :]
        return self._effort(reference, g, e, de, ca.vertcat(links, motors)), ca.SX(np.nan)

    def _tau(self, e: ca.SX) -> ca.SX:
        """Return the deviation tau (n,) [N m] of the spring torque for the errors e (2n,) of links and motors."""
        links, motors = ca.vertsplit(e, self.robot.n)
        return self.robot.K @ (motors - links)

    def _effort(self, reference: MotorMotion, g: SimpleNamespace, e: ca.SX, de: ca.SX, d: ca.SX) -> ca.SX:
        """Return u (n,) [N m] by (2) for errors, rates and disturbances (2n,) of links and motors."""
        robot, n, tau = self.robot, self.robot.n, self._tau(e)
        a, j = ca.solve(g.M, tau) + d[:n], ca.solve(g.M, self._tau(de))
        v = -(g.A_3 @ j + g.A_2 @ a + g.A_1 @ de[:n] + g.A_0 @ e[:n])
        lifted = a + np.linalg.inv(robot.K) @ (g.M @ v)  # ddtheta - ddtheta_d for d4e = v
        return effort(robot, reference.torque + tau + robot.M_m @ (lifted - d[n:]))

    def observe(
        self, kept: SimpleNamespace, s: SimpleNamespace, g: SimpleNamespace
    ) -> tuple[ca.SX, ca.SX, dict[str, ca.SX]]:
        """Return u (n,) [N m], nan for V, and the next memory."""
        robot, n, dt = self.robot, self.robot.n, s.dt
        reference = motor_motion(robot, *ca.horzsplit(s.jets))
        measured = s.position - ca.vertcat(s.jets[:, 0], reference.theta)
        rates = s.velocity - ca.vertcat(s.jets[:, 1], reference.dtheta)
        b, late, started = ca.exp(-g.bandwidth * dt), ca.if_else(dt > 0, dt, 1), dt > 0
        sent = ca.vertcat(ca.SX.zeros(n), np.linalg.solve(robot.M_m, robot.B_m) @ s.sent)
        dde = kept.known + sent + kept.d
        e, de = kept.e + dt * kept.de + dt**2 / 2 * dde, kept.de + dt * dde
        off = measured - e
        e = ca.if_else(started, e + (1 - b**3) * off, measured)
        de = ca.if_else(started, de + 1.5 * (1 - b) ** 2 * (1 + b) / late * off, rates)
        d = ca.if_else(started, kept.d + (1 - b) ** 3 / late**2 * off, 0)
        tau = self._tau(measured)
        torques = ca.vertcat(ca.solve(g.M, tau), -np.linalg.inv(robot.M_m) @ (reference.torque + tau))
        memory = {"e": e, "de": de, "d": d, "known": torques}
        return self._effort(reference, g, e, de, d), ca.SX(np.nan), memory

    @property
    def hold_damping(self) -> Array:
        """M_m trace(A_3) / n (n, n) [N m s/rad]."""
        return np.asarray(self.robot.M_m * np.trace(self.arrays["A_3"]) / self.robot.n)
