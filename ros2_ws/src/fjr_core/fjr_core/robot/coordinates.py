# SPDX-License-Identifier: Apache-2.0
"""What the law sees of a plant that is another robot: velocities are measured, momenta are made of them."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ..numerics import symbolic
from ..numerics.casadi_function import dense_function
from .robot import Robot


def law_view(plant: Robot, law: Robot) -> ca.Function | None:
    """x of the plant -> x of the law: the same velocities, momenta by the law's inertia; None: it is the same x."""
    if _same_inertia(plant, law):
        return None
    x = ca.SX.sym("x", 4 * plant.n)
    q_l, q_m, _, _ = symbolic.blocks(x, plant.n)
    dq_l, dq_m = plant.velocity_expressions(x)
    seen = ca.vertcat(q_l, q_m, law.links.M_l(q_l) @ dq_l, law.M_m @ dq_m)
    return dense_function("law_view", {"x": x}, {"seen": seen}, cse=True)


def velocity_function(robot: Robot) -> ca.Function:
    """x (4n,) of a robot -> its velocities (dq_l, dq_m) (2n,)."""
    x = ca.SX.sym("x", 4 * robot.n)
    return dense_function("velocities", {"x": x}, {"velocity": ca.vertcat(*robot.velocity_expressions(x))}, cse=True)


def _same_inertia(one: Robot, other: Robot) -> bool:
    """Whether M_m and the expression of M_l are the same; equal functions written otherwise do not count."""
    if one is other:
        return True
    M_l = [robot.links.M_l for robot in (one, other)]
    return np.array_equal(one.M_m, other.M_m) and M_l[0].serialize() == M_l[1].serialize()
