# SPDX-License-Identifier: Apache-2.0
"""Motor PD control with gravity compensation, and with feedforward of the reference.

    u = B_m^-1 (tau_ff - K_p (theta - theta_d) - K_d (dtheta - dtheta_d))

PdGravity: P. Tomei, "A simple PD controller for robots with elastic joints", IEEE Trans. Automatic Control 36(10),
1991. tau_ff = grad P_l(q_d), theta_d = q_d + K^-1 grad P_l(q_d). The paper proves regulation only: with a moving
reference, inertia and friction cause a tracking error.

PdFeedforward: A. De Luca, "Feedforward/feedback laws for the control of flexible robots", ICRA 2000. theta_d and
tau_ff = M_m ddtheta_d + D_m dtheta_d + tau_d by the inverse dynamics (inverse_dynamics.py) of the reference; for a
constant reference both laws are equal.

Only motor signals are measured. For a constant reference, q_d is the only equilibrium and
dV/dt = -dq' D_l dq - dtheta' (D_m + K_d) dtheta.

The storage and its condition are those of all laws that regulate the motors to a set point (torque_feedback.py, too).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import GainsError
from fjr_core.law.lie_derivative import Flow
from fjr_core.law.linearized import equilibria_at
from fjr_core.model.configuration_sampling import checked_configurations
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import motor_motion
from fjr_core.numerics.checks import Array

from .baseline import Baseline, damping, effort, metric

SAMPLED = 256  # configurations at which gravity is compared with the joint stiffness


def motor_set_point(f: Flow) -> tuple[ca.SX, ca.SX]:
    """Return theta_d = q_d + K^-1 grad P_l(q_d) (n,) [rad], the motor equilibrium for q_d, and its rate [rad/s]."""
    q_d = f.jets[:, 0]
    theta_d = q_d + np.linalg.inv(f.robot.K) @ f.robot.links.grad_P_l(q_d)
    return theta_d, *f.d(theta_d)


def storage(f: Flow, theta_d: ca.SX, dtheta_d: ca.SX, M_theta: ca.SX, K_theta: ca.SX) -> ca.SX:
    """Return V [J]: error energy with motor inertia M_theta and motor stiffness K_theta (Tomei 1991, eq. (10)).

    V = (de' M_l de + de_m' M_theta de_m + (e_m - e)' K (e_m - e) + e_m' K_theta e_m) / 2
        + P_l(q) - P_l(q_d) - e' grad P_l(q_d),   e = q - q_d, e_m = theta - theta_d, K (theta_d - q_d) = grad P_l(q_d).
    """
    robot, m, q_d, dq_d = f.robot, f.measured, f.jets[:, 0], f.jets[:, 1]
    e, de, e_m, de_m = m.q_l - q_d, m.dq_l - dq_d, m.q_m - theta_d, m.dq_m - dtheta_d
    kinetic = ca.dot(de, f.M_l @ de) + ca.dot(de_m, M_theta @ de_m)
    springs = ca.dot(e_m - e, robot.K @ (e_m - e)) + ca.dot(e_m, K_theta @ e_m)
    weight = robot.links.P_l(m.q_l) - robot.links.P_l(q_d) - ca.dot(e, robot.links.grad_P_l(q_d))
    return (kinetic + springs) / 2 + weight


def check_position_gain(name: str, K_p: Array, robot: Robot) -> None:
    """Raise GainsError unless K and K_p outweigh gravity, so that q_d is the only equilibrium and the minimum of V.

    Condition: the Hessian of V, [[K + N, -K], [-K, K + K_p]] with N the Hessian of P_l, is positive definite at all
    sampled configurations. Tomei 1991 requires more: its smallest eigenvalue for N = 0 exceeds the largest |N|.
    """
    smallest = float(np.linalg.eigvalsh(storage_hessians(robot, K_p))[:, 0].min())
    if not smallest > 0:
        raise GainsError(
            f"{name} and the joints' stiffness do not outweigh gravity: the Hessian of the storage has an eigenvalue "
            f"of {smallest:.4g} N m/rad; expected positive ones, else a constant reference is no minimum (Tomei 1991)"
        )


def storage_hessians(robot: Robot, K_p: Array) -> Array:
    """Return the Hessians (k, 2n, 2n) [N m/rad] of V in (q, theta) at sampled configurations."""
    K, N = robot.K, gravity_hessians(robot)
    hessians = np.repeat(np.block([[K, -K], [-K, K + K_p]])[None], len(N), axis=0)
    hessians[:, : robot.n, : robot.n] += N
    return hessians


@lru_cache(maxsize=8)
def gravity_hessians(robot: Robot) -> Array:
    """Return the Hessians N (k, n, n) [N m/rad] of P_l at sampled configurations."""
    N = equilibria_at(robot, checked_configurations(robot, None, SAMPLED)).N_l
    return np.asarray((N + N.transpose(0, 2, 1)) / 2)


@dataclass(frozen=True, eq=False)
class PdGains:
    """Motor gains K_p [N m/rad] and K_d [N m s/rad]: scalars, (n,) or (n, n)."""

    K_p: ArrayLike
    K_d: ArrayLike

    def arrays(self, robot: Robot) -> dict[str, Array]:
        """Return K_p and K_d (n, n); raise GainsError, also if K_p is too small for gravity."""
        K_p = metric("K_p", self.K_p, robot.n)
        check_position_gain("K_p", K_p, robot)
        return {"K_p": K_p, "K_d": damping("K_d", self.K_d, robot.n, robot.D_m)}

    @classmethod
    def standard(cls, robot: Robot, q_0: Array, omega: float, zeta: float, _sample_period: float = np.nan) -> PdGains:
        """Return gains with natural frequency omega [rad/s] and damping ratio zeta at q_0, assuming rigid joints."""
        M = robot.M_l(q_0) + robot.M_m
        return cls(K_p=omega**2 * M, K_d=2 * zeta * omega * M - robot.D_m)


class PdGravity(Baseline):
    """Motor PD with gravity compensation (Tomei 1991)."""

    def expressions(self, f: Flow, g: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """Return u (n,) [N m] and V [J], the storage for a constant reference."""
        m, (theta_d, dtheta_d, feedforward) = f.measured, self.reference(f)
        torque = feedforward - g.K_p @ (m.q_m - theta_d) - g.K_d @ (m.dq_m - dtheta_d)
        return effort(f.robot, torque), storage(f, theta_d, dtheta_d, ca.DM(f.robot.M_m), g.K_p)

    def reference(self, f: Flow) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return theta_d [rad], dtheta_d [rad/s] and the feedforward torque [N m], each (n,)."""
        return *motor_set_point(f), f.robot.links.grad_P_l(f.jets[:, 0])

    @property
    def hold_damping(self) -> Array:
        """Motor damping gain K_d (n, n) [N m s/rad]."""
        return self.arrays["K_d"]


class PdFeedforward(PdGravity):
    """Motor PD about the motor reference, with its feedforward torque (De Luca 2000)."""

    def reference(self, f: Flow) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return theta_d [rad], dtheta_d [rad/s] and the torque [N m] of the inverse dynamics, each (n,)."""
        d = motor_motion(f.robot, *ca.horzsplit(f.jets))
        return d.theta, d.dtheta, d.torque
