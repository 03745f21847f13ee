# SPDX-License-Identifier: Apache-2.0
"""Full state feedback with torque feedback: A. Albu-Schaeffer, C. Ott, G. Hirzinger, "A unified passivity-based
control framework for position, torque and impedance control of flexible joint robots", Int. J. Robotics Research
26(1), 2007.

    B_m u = M_m M_theta^-1 (w - tau - D_m dtheta) + tau + D_m dtheta,  so that M_theta ddtheta + D_m dtheta + tau = w
    w     = g_bar(theta) - K_theta (theta - theta_d) - D_theta (dtheta - dtheta_d)

Torque feedback gives the motors an apparent inertia M_theta, which can be chosen up to M_m. g_bar(theta) =
grad P_l(q_bar(theta)) is the gravity torque at the link equilibrium. q_d is therefore the only
equilibrium for every K_theta > 0, and the motors are passive from the torque -(tau - g_bar) to dtheta. The paper treats
regulation: theta_d = q_d + K^-1 grad P_l(q_d). For a constant reference
dV/dt = -dq' D_l dq - dtheta' (D_m + D_theta) dtheta.

TorqueFeedbackFeedforward adds feedforward for a moving reference: theta_d by the inverse dynamics (inverse_dynamics.py)
of the reference, and M_theta ddtheta_d + D_m dtheta_d + tau_d - g_bar(theta_d) in w.

Gravity from the motor positions: C. Ott, A. Albu-Schaeffer, A. Kugi, S. Stramigioli, G. Hirzinger,
"A passivity based Cartesian impedance controller for flexible joint robots, part I", ICRA 2004.

q_bar(theta) is the link equilibrium with the motors held at theta: K (theta - q_bar) = grad P_l(q_bar). It is the fixed
point of q -> theta - K^-1 grad P_l(q), which is a contraction if the joint stiffness outweighs gravity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import GainsError
from fjr_core.law.gains import relative_eigenvalues
from fjr_core.law.lie_derivative import Flow
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import motor_motion
from fjr_core.numerics.checks import Array

from .baseline import Baseline, damping, effort, metric
from .pd_gravity import gravity_hessians, motor_set_point

MOST_ITERATIONS = 400  # of the link equilibrium, a contraction
ROUNDING = 2.0**-53  # relative, of a double


@lru_cache(maxsize=8)
def link_equilibrium(robot: Robot) -> ca.Function:
    """Return the CasADi function theta (n,) -> q_bar (n,) [rad]; raise GainsError without a contraction."""
    theta, K_inverse = ca.SX.sym("theta", robot.n), ca.sparsify(ca.DM(np.linalg.inv(robot.K)))
    q = theta
    for _ in range(_iterations(robot)):
        q = theta - K_inverse @ robot.links.grad_P_l(q)
    return ca.Function("link_equilibrium", [theta], [ca.densify(q)], {"cse": True})


def _iterations(robot: Robot) -> int:
    """Return the number of steps after which the error is at rounding level.

    The contraction factor in the metric K is the maximum over sampled configurations.
    """
    half = np.linalg.inv(np.linalg.cholesky(robot.K))
    factor = float(np.abs(np.linalg.eigvalsh(half @ gravity_hessians(robot) @ half.T)).max())
    steps = 2 + np.log(ROUNDING) / np.log(factor) if 0 < factor < 1 else 2.0 if factor == 0 else np.inf
    if not steps <= MOST_ITERATIONS:
        raise GainsError(
            f"the joints' stiffness does not outweigh gravity: a change of the link position changes the deflection by "
            f"a factor of {factor:.4g}; expected at most {ROUNDING ** (1 / (MOST_ITERATIONS - 2)):.2g}, else gravity "
            "cannot be computed from the motor positions"
        )
    return int(np.ceil(steps))


FASTEST_RESONANCE = 0.2  # rad per sample, of the motor with apparent inertia on its spring
FASTEST_DAMPING = 1.0  # 1/sample, largest rate D_theta / M_theta
SMALLEST_INERTIA = 0.5  # ratio of apparent to actual motor inertia


@dataclass(frozen=True, eq=False)
class TorqueFeedbackGains:
    """Apparent motor inertia M_theta [kg m^2], K_theta [N m/rad], D_theta [N m s/rad]: scalars, (n,) or (n, n)."""

    M_theta: ArrayLike
    K_theta: ArrayLike
    D_theta: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Return M_theta, its inverse, K_theta and D_theta (n, n); raise GainsError, also if M_theta exceeds M_m."""
        M_theta, K_theta = metric("M_theta", self.M_theta, robot.n), metric("K_theta", self.K_theta, robot.n)
        largest = float(relative_eigenvalues(M_theta, robot.M_m)[-1])
        if largest > 1 + 1e-9:
            raise GainsError(f"M_theta is {largest:.4g} times M_m; expected at most 1: torque feedback reduces inertia")
        link_equilibrium(robot)
        D_theta = damping("D_theta", self.D_theta, robot.n, robot.D_m)
        return {
            "M_theta": M_theta,
            "M_theta_inverse": np.asarray(np.linalg.inv(M_theta), dtype=float),
            "K_theta": K_theta,
            "D_theta": D_theta,
        }

    @classmethod
    def standard(
        cls, robot: Robot, q_0: Array, omega: float, zeta: float, sample_period: float = 1e-3
    ) -> TorqueFeedbackGains:
        """Return gains with omega [rad/s] and damping ratio zeta at q_0, assuming rigid joints."""
        M_l, rate = robot.M_l(q_0), 2 * zeta * omega
        M_theta = shaped_inertia(robot, rate * (M_l + robot.M_m), sample_period)
        M = M_l + M_theta
        return cls(M_theta, omega**2 * M, rate * M - robot.D_m)


class TorqueFeedback(Baseline):
    """Torque feedback regulator (Albu-Schaeffer, Ott, Hirzinger 2007)."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """Return u (n,) [N m] and V [J], the storage for a constant reference."""
        robot, m = f.robot, f.measured
        q_bar, (theta_d, dtheta_d, feedforward) = link_equilibrium(robot)(m.q_m), self.reference(f, g)
        e_m, de_m = m.q_m - theta_d, m.dq_m - dtheta_d
        w = feedforward + robot.links.grad_P_l(q_bar) - g.K_theta @ e_m - g.D_theta @ de_m
        inner = robot.K @ (m.q_m - m.q_l) + robot.D_m @ m.dq_m
        torque = robot.M_m @ (g.M_theta_inverse @ (w - inner)) + inner
        shaped = (ca.dot(de_m, g.M_theta @ de_m) + ca.dot(e_m, g.K_theta @ e_m)) / 2
        return effort(robot, torque), shaped + _links_energy(f, q_bar)

    def reference(self, f: Flow, _g: SimpleNamespace) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return theta_d [rad], dtheta_d [rad/s] and the torque [N m] in w beyond gravity, each (n,)."""
        return *motor_set_point(f), ca.SX.zeros(f.robot.n)

    @property
    def hold_damping(self) -> Array:
        """Motor damping gain D_theta (n, n) [N m s/rad]."""
        return self.arrays["D_theta"]


class TorqueFeedbackFeedforward(TorqueFeedback):
    """Torque feedback about the motor reference, with feedforward."""

    def reference(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return theta_d [rad], dtheta_d [rad/s] and the feedforward torque [N m], each (n,)."""
        robot, d = f.robot, motor_motion(f.robot, *ca.horzsplit(f.jets))
        weight = robot.links.grad_P_l(link_equilibrium(robot)(d.theta))
        return d.theta, d.dtheta, g.M_theta @ d.ddtheta + robot.D_m @ d.dtheta + d.tau - weight


def _links_energy(f: Flow, q_bar: ca.SX) -> ca.SX:
    """Energy [J] of links, springs and gravity relative to the link equilibrium q_bar at the present motor position.

    de' M_l de / 2 + h' K h / 2 + P_l(q) - P_l(q_bar) - h' grad P_l(q_bar),  de = dq - dq_d, h = q - q_bar.
    """
    robot, m, links = f.robot, f.measured, f.robot.links
    de, h = m.dq_l - f.jets[:, 1], m.q_l - q_bar
    weight = links.P_l(m.q_l) - links.P_l(q_bar) - ca.dot(h, links.grad_P_l(q_bar))
    return (ca.dot(de, f.M_l @ de) + ca.dot(h, robot.K @ h)) / 2 + weight


def shaped_inertia(robot: Robot, D: Array, sample_period: float) -> Array:
    """Return M_theta (n, n): per mode of (K, M_m), the smallest inertia >= SMALLEST_INERTIA M_m that sampling allows.

    The motor resonance on its spring is at most FASTEST_RESONANCE, and the rate of the damping D (n, n) [N m s/rad] at
    most FASTEST_DAMPING.
    """
    L = np.linalg.cholesky(robot.M_m)
    half = np.linalg.inv(L)
    squares, V = np.linalg.eigh(half @ robot.K @ half.T)
    damped = float(relative_eigenvalues(D, robot.M_m)[-1]) * sample_period / FASTEST_DAMPING
    parts = np.clip(squares * (sample_period / FASTEST_RESONANCE) ** 2, min(max(SMALLEST_INERTIA, damped), 1.0), 1.0)
    M_theta = L @ (V * parts) @ V.T @ L.T
    return np.asarray((M_theta + M_theta.T) / 2)
