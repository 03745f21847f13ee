# SPDX-License-Identifier: Apache-2.0
"""Linearise the plant and v-dPBC about the equilibria of a robot in closed form, for a stack of k configurations.

Equilibrium: x = (q_l, q_l + K^-1 grad P_l, 0, 0); the springs carry the weight. With q_ld = q_l all errors are zero
there, and E_l, C and d/dt M_l are of second order. Springs that harden have the tangent stiffness under the weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model import springs
from ..model.robot import Robot
from ..motions.reference import JETS
from ..numerics.checks import Array
from ..numerics.symbolic import evaluate_rows, symbols
from .gains import CheckedGains
from .interfaces import StaticLaw

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Equilibria:
    """Equilibria at link positions q_l (k, n) [rad], with the inertia M_l and the Hessian N_l of P_l, (k, n, n)."""

    robot: Robot
    q_l: Array
    M_l: Array
    N_l: Array

    @cached_property
    def weights(self) -> Array:
        """Gravity torques grad P_l (k, n) [N m]."""
        return np.asarray(self.robot.links.grad_P_l.map(len(self.q_l))(self.q_l.T).full().T)

    @cached_property
    def deflections(self) -> Array:
        """Deflections of the springs (k, n) [rad] under the weights."""
        return ca.DM(springs.deflection(self.robot, ca.DM(self.weights.T))).full().T

    @cached_property
    def hardening(self) -> Array:
        """Tangents phi' of the springs over K (k, n); (1, n) ones for straight springs."""
        return springs.hardening(self.robot, self.deflections if self.robot.curve else np.zeros((1, self.robot.n)))

    @cached_property
    def K(self) -> Array:
        """Stiffness (n, n), or tangents of springs that harden (k, n, n) [N m/rad]."""
        return self.robot.K * self.hardening[:, None] if self.robot.curve else self.robot.K

    @property
    def u(self) -> Array:
        """Equilibrium efforts (k, n) [N m]."""
        return np.asarray(self.weights @ np.linalg.inv(self.robot.B_m).T)

    @property
    def x(self) -> Array:
        """Equilibrium states (k, 4n)."""
        q_m = self.q_l + self.deflections
        return np.hstack([self.q_l, q_m, np.zeros_like(q_m), np.zeros_like(q_m)])

    def at(self, indices: Indices) -> Equilibria:
        """Return the equilibria with these indices."""
        return Equilibria(self.robot, self.q_l[indices], self.M_l[indices], self.N_l[indices])

    def blocks(self, *rows: Sequence[ArrayLike]) -> Array:
        """Return a stack (k, rows n, columns n) of block matrices; blocks are (n, n), (k, n, n) or 0."""
        k, n, _ = self.M_l.shape
        whole = np.empty((k, n * len(rows), n * len(rows[0])))
        for i, row in enumerate(rows):
            for j, block in enumerate(row):
                whole[:, n * i : n * (i + 1), n * j : n * (j + 1)] = block
        return whole

    def block_diagonal(self, *parts: ArrayLike) -> Array:
        """Return a stack (k, 4n, 4n) of block-diagonal matrices; parts as in `blocks`."""
        return self.blocks(*([part if i == j else 0 for j in range(len(parts))] for i, part in enumerate(parts)))


def equilibria_at(robot: Robot, configurations: Array) -> Equilibria:
    """Return the equilibria of a robot at configurations (k, n) [rad]."""
    q_l = ca.SX.sym("q_l", robot.n)
    hessian = ca.jacobian(robot.links.grad_P_l(q_l), q_l)
    both = ca.Function("M_l_and_N_l", [q_l], [ca.densify(robot.links.M_l(q_l)), ca.densify(hessian)])
    columns = (each.reshape(-1, robot.n, robot.n) for each in evaluate_rows(both, configurations))
    return Equilibria(robot, configurations, *(np.ascontiguousarray(each.swapaxes(1, 2)) for each in columns))


def plant_matrices(points: Equilibria) -> tuple[Array, Array]:
    """Return A (k, 4n, 4n) and B (k, 4n, n) of dx = A x + B u, eq. (36) linearised about the equilibria."""
    r, K, W_l, W_m = points.robot, points.K, np.linalg.inv(points.M_l), np.linalg.inv(points.robot.M_m)
    A = points.blocks(
        [0, 0, W_l, 0],
        [0, 0, 0, W_m],
        [-points.N_l - K, K, -r.D_l @ W_l, 0],
        [K, -K, 0, -r.D_m @ W_m],
    )
    return A, points.blocks([0], [0], [0], [r.B_m])


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
    q_md = q_l + np.linalg.inv(points.K) @ u_l
    q_tilde_m = q_m - q_md  # (39)
    v_mr = q_md @ A - g.Lambda_m @ q_tilde_m - np.linalg.inv(g.Pi_m) @ np.swapaxes(points.K, -1, -2) @ s_l  # (40)
    sigma_m = p_m - r.M_m @ v_mr  # (39)
    return np.concatenate([q_l, q_tilde_m, sigma_l, sigma_m], axis=1)


def error_dynamics(points: Equilibria, gains: CheckedGains) -> Array:
    """Return A_e (k, 4n, 4n) of the continuous-time error dynamics de = A_e e, with E_l = 0."""
    r, g, K = points.robot, gains, points.K
    W_l, W_m = np.linalg.inv(points.M_l), np.linalg.inv(r.M_m)
    return points.blocks(
        [-g.Lambda_l, 0, W_l, 0],
        [0, -g.Lambda_m, -np.linalg.inv(g.Pi_m) @ np.swapaxes(K, -1, -2) @ W_l, W_m],
        [-g.Pi_l, K, -(r.D_l + g.K_ld) @ W_l, 0],
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


def slope_at_rest(law: StaticLaw, q_l: Array, robot: Robot | None = None) -> tuple[Array, Array]:
    """Return F (n, 4n), G (n, n): du = F d(q_l, q_m, dq_l, dq_m) + G dq_ld, links and reference at rest at q_l (n,).

    robot: whose springs carry the weight, by default that of the law.
    """
    n, position = law.robot.n, rest_position(robot or law.robot, q_l)
    slope = _slope(law.measured_expression, ca.MX if law.in_python else ca.SX)
    found = slope(np.concatenate([position, np.zeros(2 * n), q_l]), law.gain_values, np.eye(5 * n)).full()
    law.raise_failure()
    return found[:, : 4 * n], found[:, 4 * n :]


def rest_position(robot: Robot, q_l: Array) -> Array:
    """Return (q_l, q_m) (2n,) [rad] at the equilibrium with links at q_l (n,): the springs carry the weight."""
    return np.concatenate([q_l, q_l + robot.deflection(robot.grad_P_l(q_l))])


@lru_cache(maxsize=8)
def _slope(measured: ca.Function, kind: type) -> ca.Function:
    """Build (z, gains, d) -> derivative of u along d (5n,) at z = (position, velocity, q_ld), the reference at rest."""
    n = measured.size1_in("jets")
    z, gains, d = symbols(kind, z=5 * n, gains=measured.size1_in("gains"), d=5 * n).values()
    position, velocity, q_ld = ca.vertsplit(z, [0, 2 * n, 4 * n, 5 * n])
    u, _ = measured(position, velocity, ca.horzcat(q_ld, ca.DM(n, JETS - 1)), gains)
    return ca.Function("slope", [z, gains, d], [ca.densify(ca.jtimes(u, z, d))], {"cse": True})
