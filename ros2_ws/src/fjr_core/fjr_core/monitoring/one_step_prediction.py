# SPDX-License-Identifier: Apache-2.0
"""Predict measured positions and velocities one sample ahead with the model, the effort held."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from ..law.vdpbc import TrackingLaw
from ..model.port_hamiltonian import Plant
from ..model.robot import Coordinates
from ..numerics.checks import Array
from ..numerics.integrators import rk4_expression
from ..numerics.symbolic import dense_function, symbols

STEPS = 4  # integrator steps per call
LONGEST = 1e-3  # s, longest horizon of a call; longer intervals take several calls


class Prediction:
    """One-step-ahead prediction by the model of the law; machine code if the law is compiled."""

    def __init__(self, law: TrackingLaw) -> None:
        self._law = law

    def along(self, position: Array, velocity: Array, u: Array, dt: Array) -> tuple[Array, Array]:
        """Return positions and velocities (k, 2n) after dt (k,) [s] under held efforts u (k, n) [N m].

        position, velocity (k, 2n) [rad, rad/s]: at the start.
        """
        position, velocity = position.copy(), velocity.copy()
        calls = np.maximum(1, np.ceil(dt / LONGEST - 1e-6)).astype(int)
        for count in np.unique(calls):  # a gap does not make every interval take as long
            rows = np.flatnonzero(calls == count)
            q, dq = ca.DM(position[rows].T), ca.DM(velocity[rows].T)
            for _ in range(count):
                q, dq = self.function(q, dq, u[rows].T, dt[None, rows] / count)
            position[rows], velocity[rows] = q.full().T, dq.full().T
        return position, velocity

    @cached_property
    def function(self) -> ca.Function:
        """Return the CasADi function (position, velocity, u, dt) -> next position, next velocity."""
        return self._law.derived("prediction", self._derived)

    def _derived(self) -> ca.Function:
        robot = self._law.robot
        n = robot.n
        s, dynamics = symbols(ca.MX, position=2 * n, velocity=2 * n, u=n, dt=1), Plant(robot).dynamics
        position, velocity, u, dt = s.values()
        coordinates = Coordinates(robot)
        x = coordinates.to_momenta(position, velocity)
        for _ in range(STEPS):
            x = rk4_expression(dynamics, x, (u, u, u), dt / STEPS)
        outputs = {"next_position": x[: 2 * n], "next_velocity": coordinates.to_velocities(x)}
        return dense_function("prediction", s, outputs)
