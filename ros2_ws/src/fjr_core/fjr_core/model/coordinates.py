# SPDX-License-Identifier: Apache-2.0
"""The change of coordinates between measured velocities and the momenta of eq. (36)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from ..numerics.casadi_function import dense_function
from ..numerics.symbolic import symbols
from .robot import Robot


@dataclass(frozen=True, eq=False)
class Coordinates:
    """CasADi functions between (position, velocity), (2n,) each, and the state x (4n,) with momenta.

    position (q_l, q_m) [rad], velocity (dq_l, dq_m) [rad/s], x = (q_l, q_m, p_l, p_m).
    Equations: p_l = M_l(q_l) dq_l, p_m = M_m dq_m.
    """

    robot: Robot

    @cached_property
    def to_momenta(self) -> ca.Function:
        """Map (position, velocity) to the state x."""
        n = self.robot.n
        s = symbols(position=2 * n, velocity=2 * n)
        position, velocity = s.values()
        momenta = self.robot.momentum_expressions(position[:n], velocity[:n], velocity[n:])
        return dense_function("to_momenta", s, {"x": ca.vertcat(position, *momenta)}, cse=True)

    @cached_property
    def to_velocities(self) -> ca.Function:
        """Map the state x to the velocity."""
        x = ca.SX.sym("x", 4 * self.robot.n)
        velocity = ca.vertcat(*self.robot.velocity_expressions(x))
        return dense_function("to_velocities", {"x": x}, {"velocity": velocity}, cse=True)

    @cached_property
    def to_measured(self) -> ca.Function:
        """Map the state x to (position, velocity)."""
        x = ca.SX.sym("x", 4 * self.robot.n)
        outputs = {"position": x[: 2 * self.robot.n], "velocity": self.to_velocities(x)}
        return dense_function("to_measured", {"x": x}, outputs, cse=True)


def law_view(plant: Robot, law: Robot) -> ca.Function | None:
    """Return the CasADi function from the plant's x to the law's x with equal velocities.

    Momenta are computed with the inertia of the law's robot. Return None if both robots have the same inertia: M_m and
    the expression of M_l; equal functions that are written differently count as different.
    """
    M_l = [robot.links.M_l for robot in (plant, law)]
    if plant is law or (np.array_equal(plant.M_m, law.M_m) and M_l[0].serialize() == M_l[1].serialize()):
        return None
    x, positions = ca.SX.sym("x", 4 * plant.n), 2 * plant.n
    seen = Coordinates(law).to_momenta(x[:positions], Coordinates(plant).to_velocities(x))
    return dense_function("law_view", {"x": x}, {"seen": seen}, cse=True)
