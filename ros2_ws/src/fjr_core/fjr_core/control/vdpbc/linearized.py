# SPDX-License-Identifier: Apache-2.0
"""v-dPBC linearised at the equilibria of a robot, in closed form, stacked over k configurations.

q_ld = q_l there, so all errors are zero and E_l, C and d/dt M_l are of second order.
"""

from __future__ import annotations

import numpy as np

from ...numerics.checks import Array
from ...robot.equilibrium import RestPoints, plant_matrices
from .gains import CheckedGains


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
