# SPDX-License-Identifier: Apache-2.0
"""How a law's effort changes with what is measured and with where the reference stands; to first order."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from ..control.static_law import StaticLaw
from ..numerics.checks import Array
from ..numerics.symbolic import directional
from ..robot.robot import Robot
from ..trajectories.reference import JETS


def slope_at_rest(law: StaticLaw, q_l: Array) -> tuple[Array, Array]:
    """F (n, 4n), G (n, n): du = F d(q_l, q_m, dq_l, dq_m) + G dq_ld, links and reference at rest at q_l (n,) [rad]."""
    n, position = law.robot.n, rest_position(law.robot, q_l)
    found = _slope(law.measured_expression)(position, np.zeros(2 * n), q_l, law.gain_values, np.eye(5 * n)).full()
    return found[:, : 4 * n], found[:, 4 * n :]


def rest_position(robot: Robot, q_l: Array) -> Array:
    """(q_l, q_m) (2n,) [rad] at rest: the springs carry the weight."""
    return np.concatenate([q_l, q_l + np.linalg.solve(robot.K, robot.grad_P_l(q_l))])


@lru_cache(maxsize=8)
def _slope(measured: ca.Function) -> ca.Function:
    """(position, velocity, q_ld, gains, d) -> derivative of u along d (5n,), the reference at rest in q_ld."""
    n = measured.size1_in("jets")
    sizes = {"position": 2 * n, "velocity": 2 * n, "q_ld": n, "gains": measured.size1_in("gains"), "d": 5 * n}
    position, velocity, q_ld, gains, d = symbols = [ca.SX.sym(name, size) for name, size in sizes.items()]
    u, _ = measured(position, velocity, ca.horzcat(q_ld, ca.SX.zeros(n, JETS - 1)), gains)
    slope = directional(u, ca.vertcat(position, velocity, q_ld), d)
    return ca.Function("slope", symbols, [ca.densify(slope)], {"cse": True})
