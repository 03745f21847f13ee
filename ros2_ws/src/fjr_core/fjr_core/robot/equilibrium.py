# SPDX-License-Identifier: Apache-2.0
"""Plant, law and errors linearised at rest, in closed form; everything is a stack over k configurations.

At rest x = (q_l, q_l + K^-1 grad P_l, 0, 0) and q_ld = q_l, so all errors are zero and E_l, C and d/dt M_l are of
second order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..control.vdpbc.gains import CheckedGains
from ..numerics.checks import Array
from .robot import Robot

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class RestPoints:
    """Configurations q_l (k, n) of a robot with M_l and the Hessian N_l of P_l there, each (k, n, n)."""

    robot: Robot
    q_l: Array
    M_l: Array
    N_l: Array

    @cached_property
    def weights(self) -> Array:
        """grad P_l (k, n) [N m]."""
        return np.array([self.robot.grad_P_l(q_l) for q_l in self.q_l])

    @property
    def u(self) -> Array:
        """The efforts (k, n) [N m] that hold the robot at rest."""
        return np.asarray(self.weights @ np.linalg.inv(self.robot.B_m).T)

    @property
    def x(self) -> Array:
        """The states at rest (k, 4n): the springs carry the weight."""
        q_m = self.q_l + self.weights @ np.linalg.inv(self.robot.K).T
        return np.hstack([self.q_l, q_m, np.zeros_like(q_m), np.zeros_like(q_m)])

    def at(self, indices: Indices) -> RestPoints:
        """Some of them."""
        return RestPoints(self.robot, self.q_l[indices], self.M_l[indices], self.N_l[indices])

    def blocks(self, *rows: Sequence[ArrayLike]) -> Array:
        """A stack (k, rows n, columns n) from blocks (n, n) or (k, n, n); 0 is a zero block."""
        shape = self.M_l.shape
        spread = [[np.broadcast_to(entry, shape) for entry in row] for row in rows]
        return np.concatenate([np.concatenate(row, axis=2) for row in spread], axis=1)


def rest_points(robot: Robot, configurations: Array) -> RestPoints:
    """The rest points of a robot at configurations (k, n)."""
    q_l = ca.SX.sym("q_l", robot.n)
    hessian = ca.Function("N_l", [q_l], [ca.densify(ca.jacobian(robot.links.grad_P_l(q_l), q_l))])
    M_l = np.array([robot.M_l(q) for q in configurations])
    return RestPoints(robot, configurations, M_l, np.array([hessian(q).full() for q in configurations]))


def plant_matrices(rest: RestPoints) -> tuple[Array, Array]:
    """A (k, 4n, 4n) and B (k, 4n, n) of dx = A x + B u about the rest points, eq. (36)."""
    r, W_l, W_m = rest.robot, np.linalg.inv(rest.M_l), np.linalg.inv(rest.robot.M_m)
    A = rest.blocks(
        [0, 0, W_l, 0],
        [0, 0, 0, W_m],
        [-rest.N_l - r.K, r.K, -r.D_l @ W_l, 0],
        [r.K, -r.K, 0, -r.D_m @ W_m],
    )
    return A, rest.blocks([0], [0], [0], [r.B_m])


def error_matrices(rest: RestPoints, gains: CheckedGains) -> Array:
    """Theta (k, 4n, 4n): e = Theta x about the rest points, e = (q_tilde_l, q_tilde_m, sigma_l, sigma_m)."""
    r, g, M_l, one = rest.robot, gains, rest.M_l, np.eye(rest.robot.n)
    A, _ = plant_matrices(rest)
    q_l, q_m = rest.blocks([one, 0, 0, 0]), rest.blocks([0, one, 0, 0])
    p_l, p_m = rest.blocks([0, 0, one, 0]), rest.blocks([0, 0, 0, one])
    v_lr = -g.Lambda_l @ q_l  # (31), q_tilde_l = q_l
    sigma_l = p_l - M_l @ v_lr  # (30)
    s_l = np.linalg.solve(M_l, sigma_l)
    u_l = M_l @ v_lr @ A + rest.N_l @ q_l + r.D_l @ v_lr - g.Pi_l @ q_l - g.K_ld @ s_l  # (33)
    q_md = q_l + np.linalg.inv(r.K) @ u_l
    q_tilde_m = q_m - q_md  # (39)
    v_mr = q_md @ A - g.Lambda_m @ q_tilde_m - np.linalg.inv(g.Pi_m) @ r.K.T @ s_l  # (40)
    sigma_m = p_m - r.M_m @ v_mr  # (39)
    return np.concatenate([q_l, q_tilde_m, sigma_l, sigma_m], axis=1)


def error_dynamics(rest: RestPoints, gains: CheckedGains) -> Array:
    """A_e (k, 4n, 4n): the closed loop de = A_e e in continuous time, the error dynamics with E_l = 0."""
    r, g = rest.robot, gains
    W_l, W_m = np.linalg.inv(rest.M_l), np.linalg.inv(r.M_m)
    return rest.blocks(
        [-g.Lambda_l, 0, W_l, 0],
        [0, -g.Lambda_m, -np.linalg.inv(g.Pi_m) @ r.K.T @ W_l, W_m],
        [-g.Pi_l, r.K, -(r.D_l + g.K_ld) @ W_l, 0],
        [0, -g.Pi_m, 0, -(r.D_m + g.K_md) @ W_m],
    )


def feedback(rest: RestPoints, gains: CheckedGains) -> Array:
    """F (k, n, 4n): the law u = F x about the rest points; what turns the plant into the error dynamics."""
    A, _ = plant_matrices(rest)
    Theta = error_matrices(rest, gains)
    closed = np.linalg.solve(Theta, error_dynamics(rest, gains) @ Theta)
    return np.linalg.inv(rest.robot.B_m) @ (closed - A)[:, 3 * rest.robot.n :]


def metric_roots(rest: RestPoints, gains: CheckedGains) -> Array:
    """S (k, 4n, 4n) with S' S = P = diag(Pi_l, Pi_m, M_l^-1, M_m^-1): V = |S e|^2 / 2, eq. (43)."""
    root_l, root_m = np.linalg.cholesky(gains.Pi_l).T, np.linalg.cholesky(gains.Pi_m).T
    L_l, L_m = np.linalg.cholesky(rest.M_l), np.linalg.cholesky(rest.robot.M_m)
    return rest.blocks(
        [root_l, 0, 0, 0], [0, root_m, 0, 0], [0, 0, np.linalg.inv(L_l), 0], [0, 0, 0, np.linalg.inv(L_m)]
    )
