# SPDX-License-Identifier: Apache-2.0
"""A robot in motion: state, exact time and held effort, advanced in fixed inner steps; without ROS."""

from __future__ import annotations

import numpy as np

from fjr_core import Plant, StateError
from fjr_core.checks import Array


class SimulatedRobot:
    """A plant with a state, a time [ns, integer, exact] and an effort that is held between commands."""

    def __init__(self, plant: Plant, x0: Array, inner_step: int) -> None:
        """x0: initial state (4n,); inner_step: integrator step [ns]."""
        self._plant = plant
        self._x0 = x0
        self._inner_step = inner_step
        self.reset()

    def reset(self) -> None:
        """Back to the initial state and time 0, no effort."""
        self.time = 0
        self.x = self._x0.copy()
        self.u: Array = np.zeros(self._plant.robot.n)

    def warm_up(self) -> None:
        """Build everything that is built once, so that the first step is as fast as any other."""
        self._plant.step(self._x0, np.zeros(self._plant.robot.n), self._inner_step * 1e-9)
        self.measure()

    def advance_to(self, time: int) -> None:
        """Integrate in whole inner steps up to, and never past, `time` [ns]; raises StateError on divergence."""
        while self.time + self._inner_step <= time:
            self.x = self._plant.step(self.x, self.u, self._inner_step * 1e-9)
            self.time += self._inner_step
        if not np.isfinite(self.x).all():
            raise StateError(f"the robot's state is not finite after {self.time * 1e-9:.3f} s: the motion diverged")

    def measure(self) -> tuple[Array, Array, Array]:
        """Positions (q_l, q_m) [rad], velocities [rad/s] and efforts (K zeta, applied u) [N m], each (2n,)."""
        n, robot = self._plant.robot.n, self._plant.robot
        position = self.x[: 2 * n]
        spring = robot.K @ (position[n:] - position[:n])
        applied = robot.B_m @ self.u
        return position, np.concatenate(robot.velocities(self.x)), np.concatenate([spring, applied])
