# SPDX-License-Identifier: Apache-2.0
"""Set point, storage function and positivity condition of the motor-side regulators."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from fjr_core.errors import GainsError
from fjr_core.law.lie_derivative import Flow
from fjr_core.law.linearized import equilibria_at
from fjr_core.model.configuration_sampling import checked_configurations
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array

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
    blocks = np.block([[K, -K], [-K, K + K_p]])
    hessians = np.repeat(blocks[None], len(N), axis=0)
    hessians[:, : robot.n, : robot.n] += N
    return hessians


@lru_cache(maxsize=8)
def gravity_hessians(robot: Robot) -> Array:
    """Return the Hessians N (k, n, n) [N m/rad] of P_l at sampled configurations."""
    N = equilibria_at(robot, checked_configurations(robot, None, SAMPLED)).N_l
    return np.asarray((N + N.transpose(0, 2, 1)) / 2)
