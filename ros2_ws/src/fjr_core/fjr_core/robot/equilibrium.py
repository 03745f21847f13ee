# SPDX-License-Identifier: Apache-2.0
"""The equilibria of a robot and its plant linearised there, in closed form, stacked over k configurations.

x = (q_l, q_l + K^-1 grad P_l, 0, 0): the springs carry the weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

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
