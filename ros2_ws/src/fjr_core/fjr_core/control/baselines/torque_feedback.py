# SPDX-License-Identifier: Apache-2.0
"""Full state feedback with torque feedback: A. Albu-Schaeffer, C. Ott, G. Hirzinger, "A unified passivity-based
control framework for position, torque and impedance control of flexible joint robots", Int. J. Robotics Research
26(1), 2007.

    B_m u = M_m M_theta^-1 (w - tau - D_m dtheta) + tau + D_m dtheta,  so that M_theta ddtheta + D_m dtheta + tau = w
    w     = g_bar(theta) - K_theta (theta - theta_d) - D_theta (dtheta - dtheta_d)

Torque feedback gives the motors an apparent inertia M_theta, which is free below M_m. g_bar(theta) =
grad P_l(q_bar(theta)) is gravity where the links would rest (online_gravity.py). So q_d is the only rest for every
K_theta > 0, and from the torque -(tau - g_bar) to dtheta the motors are passive. The paper regulates:
theta_d = q_d + K^-1 grad P_l(q_d), and where the reference stands dV/dt = -dq' D_l dq - dtheta' (D_m + D_theta) dtheta.

TorqueFeedbackFeedforward adds what users add for a moving reference: theta_d by the inverse dynamics of
the reference, and in w  M_theta ddtheta_d + D_m dtheta_d + tau_d - g_bar(theta_d).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ...errors import GainsError
from ...numerics.checks import Array
from ...robot.robot import Robot
from ..inverse_dynamics import motor_motion
from ..lie_derivative import Flow
from ..vdpbc.gains import relative_eigenvalues
from .baseline import Baseline, damping, effort, metric
from .online_gravity import rest_position
from .set_point_storage import standing_reference

QUICKEST = 0.2  # rad a sample: the shaped motor's resonance on its spring
MOST_DAMPED = 1.0  # 1/sample: the rate D_theta / M_theta of the shaped motor
LIGHTEST = 0.5  # of M_m


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
        rest_position(robot)
        D_theta = damping("D_theta", self.D_theta, robot.n, robot.D_m)
        return {
            "M_theta": M_theta,
            "M_theta_inverse": np.asarray(np.linalg.inv(M_theta), dtype=float),
            "K_theta": K_theta,
            "D_theta": D_theta,
        }


class TorqueFeedback(Baseline):
    """The regulator of the paper."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """u and V, the storage for a standing reference."""
        robot, m = f.robot, f.measured
        q_bar, (theta_d, dtheta_d, feedforward) = rest_position(robot)(m.q_m), self.reference(f, g)
        e_m, de_m = m.q_m - theta_d, m.dq_m - dtheta_d
        w = feedforward + robot.links.grad_P_l(q_bar) - g.K_theta @ e_m - g.D_theta @ de_m
        inner = robot.K @ (m.q_m - m.q_l) + robot.D_m @ m.dq_m
        torque = robot.M_m @ (g.M_theta_inverse @ (w - inner)) + inner
        shaped = (ca.dot(de_m, g.M_theta @ de_m) + ca.dot(e_m, g.K_theta @ e_m)) / 2
        return effort(robot, torque), shaped + _links_energy(f, q_bar)

    def reference(self, f: Flow, _g: SimpleNamespace) -> tuple[ca.SX, ca.SX, ca.SX]:
        """theta_d [rad], dtheta_d [rad/s] and the torque [N m] that w has beyond gravity, each (n,)."""
        return *standing_reference(f), ca.SX.zeros(f.robot.n)

    @property
    def hold_damping(self) -> Array:
        """D_theta."""
        return self.arrays["D_theta"]


class TorqueFeedbackFeedforward(TorqueFeedback):
    """The regulator about the reference's own motion."""

    def reference(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX, ca.SX]:
        """theta_d [rad], dtheta_d [rad/s] and the torque [N m] by the inverse dynamics, each (n,)."""
        robot, d = f.robot, motor_motion(f.robot, *ca.horzsplit(f.jets))
        weight = robot.links.grad_P_l(rest_position(robot)(d.theta))
        return d.theta, d.dtheta, g.M_theta @ d.ddtheta + robot.D_m @ d.dtheta + d.tau - weight


def _links_energy(f: Flow, q_bar: ca.SX) -> ca.SX:
    """Energy [J] of the links, springs and gravity above that of rest at q_bar with the motors where they are.

    de' M_l de / 2 + h' K h / 2 + P_l(q) - P_l(q_bar) - h' grad P_l(q_bar),  de = dq - dq_d, h = q - q_bar.
    """
    robot, m, links = f.robot, f.measured, f.robot.links
    de, h = m.dq_l - f.jets[:, 1], m.q_l - q_bar
    weight = links.P_l(m.q_l) - links.P_l(q_bar) - ca.dot(h, links.grad_P_l(q_bar))
    return (ca.dot(de, f.M_l @ de) + ca.dot(h, robot.K @ h)) / 2 + weight


def standard(robot: Robot, q_0: Array, omega: float, zeta: float, sample_period: float = 1e-3) -> TorqueFeedbackGains:
    """Were the joints rigid, omega [rad/s] and the damping ratio zeta at q_0; motors as light as sampling allows."""
    M_l, rate = robot.M_l(q_0), 2 * zeta * omega
    M_theta = shaped_inertia(robot, rate * (M_l + robot.M_m), sample_period)
    M = M_l + M_theta
    return TorqueFeedbackGains(M_theta, omega**2 * M, rate * M - robot.D_m)


def shaped_inertia(robot: Robot, D: Array, sample_period: float) -> Array:
    """M_theta (n, n): in every mode of (K, M_m) the least inertia from LIGHTEST M_m to M_m that sampling allows.

    The motor resonates on its spring at most at QUICKEST, and the damping D (n, n) slows it at a rate of at most
    MOST_DAMPED.
    """
    L = np.linalg.cholesky(robot.M_m)
    half = np.linalg.inv(L)
    squares, V = np.linalg.eigh(half @ robot.K @ half.T)
    damped = float(relative_eigenvalues(D, robot.M_m)[-1]) * sample_period / MOST_DAMPED
    parts = np.clip(squares * (sample_period / QUICKEST) ** 2, min(max(LIGHTEST, damped), 1.0), 1.0)
    M_theta = L @ (V * parts) @ V.T @ L.T
    return np.asarray((M_theta + M_theta.T) / 2)
