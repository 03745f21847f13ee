# SPDX-License-Identifier: Apache-2.0
"""Linearise v-dPBC about the equilibria of a robot in closed form, for a stack of k configurations.

At an equilibrium q_ld = q_l: all errors are zero, and E_l, C and d/dt M_l are of second order.
"""

from __future__ import annotations

import numpy as np

from ...model.equilibrium import Equilibria, plant_matrices
from ...numerics.checks import Array
from .gains import CheckedGains


def error_matrices(points: Equilibria, gains: CheckedGains) -> Array:
    """Return Theta (k, 4n, 4n): e = Theta x about the equilibria, e = (q_tilde_l, q_tilde_m, sigma_l, sigma_m)."""
    r, g, M_l, one = points.robot, gains, points.M_l, np.eye(points.robot.n)
    A, _ = plant_matrices(points)
    q_l, q_m = points.blocks([one, 0, 0, 0]), points.blocks([0, one, 0, 0])
    p_l, p_m = points.blocks([0, 0, one, 0]), points.blocks([0, 0, 0, one])
    v_lr = -g.Lambda_l @ q_l  # (31), q_tilde_l = q_l
    sigma_l = p_l - M_l @ v_lr  # (30)
    s_l = np.linalg.solve(M_l, sigma_l)
    u_l = M_l @ v_lr @ A + points.N_l @ q_l + r.D_l @ v_lr - g.Pi_l @ q_l - g.K_ld @ s_l  # (33)
    q_md = q_l + np.linalg.inv(r.K) @ u_l
    q_tilde_m = q_m - q_md  # (39)
    v_mr = q_md @ A - g.Lambda_m @ q_tilde_m - np.linalg.inv(g.Pi_m) @ r.K.T @ s_l  # (40)
    sigma_m = p_m - r.M_m @ v_mr  # (39)
    return np.concatenate([q_l, q_tilde_m, sigma_l, sigma_m], axis=1)


def error_dynamics(points: Equilibria, gains: CheckedGains) -> Array:
    """Return A_e (k, 4n, 4n) of the continuous-time error dynamics de = A_e e, with E_l = 0."""
    r, g = points.robot, gains
    W_l, W_m = np.linalg.inv(points.M_l), np.linalg.inv(r.M_m)
    return points.blocks(
        [-g.Lambda_l, 0, W_l, 0],
        [0, -g.Lambda_m, -np.linalg.inv(g.Pi_m) @ r.K.T @ W_l, W_m],
        [-g.Pi_l, r.K, -(r.D_l + g.K_ld) @ W_l, 0],
        [0, -g.Pi_m, 0, -(r.D_m + g.K_md) @ W_m],
    )


def feedback(points: Equilibria, gains: CheckedGains) -> Array:
    """Return F (k, n, 4n) of the linearised law u = F x, which turns the plant into the error dynamics."""
    A, _ = plant_matrices(points)
    Theta = error_matrices(points, gains)
    closed = np.linalg.solve(Theta, error_dynamics(points, gains) @ Theta)
    return np.linalg.inv(points.robot.B_m) @ (closed - A)[:, 3 * points.robot.n :]


def metric_roots(points: Equilibria, gains: CheckedGains) -> Array:
    """Return S (k, 4n, 4n) with S' S = P = diag(Pi_l, Pi_m, M_l^-1, M_m^-1): V = |S e|^2 / 2, eq. (43)."""
    root_l, root_m = np.linalg.cholesky(gains.Pi_l).T, np.linalg.cholesky(gains.Pi_m).T
    L_l, L_m = np.linalg.cholesky(points.M_l), np.linalg.cholesky(points.robot.M_m)
    return points.block_diagonal(root_l, root_m, np.linalg.inv(L_l), np.linalg.inv(L_m))
