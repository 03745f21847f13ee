# SPDX-License-Identifier: Apache-2.0
"""Closed loop in lock-step with a fault of a sensor, effort or spring that is not a plant parameter."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_plant.lock_step import START

from .loop import LockStepLoop, Sample

Change = Callable[[Array], Array]


@dataclass(frozen=True)
class Fault:
    """Changes of measured position and velocity (2n,) and of the acting effort (n,); spring and link torques.

    spring: deflection (n,) -> torque (n,) [N m] on the links in addition to K zeta, with its reaction on the motors.
    push (n,) [N m]: on the links. delay: of the velocities, in samples.
    """

    position: Change | None = None
    velocity: Change | None = None
    effort: Change | None = None
    spring: Change | None = None
    push: Array | None = None
    delay: int = 0
    delayed: NDArray[np.bool_] | None = None


class FaultyLoop(LockStepLoop):
    """Run a scenario in lock-step with a fault; raise ParameterError for invalid values."""

    def __init__(self, scenario: Scenario, fault: Fault) -> None:
        self._fault = fault
        self._velocities: deque[Array] = deque(maxlen=fault.delay + 1)  # the latest ones
        self.found_after = 0  # samples before the state that reveals a wiring fault; 0: none found
        super().__init__(scenario)
        self._B_m = scenario.plant.robot.B_m
        self._inner = self._transport.period // int(scenario.plant_values["inner_steps"])  # type: ignore[arg-type]
        self._command: Array = np.zeros(scenario.robot.n)
        if fault.push is not None:
            self._robot.external = fault.push

    def _sample(self) -> Sample:
        position, velocity, effort = self._robot.measure()
        if self._fault.position is not None:
            position = self._fault.position(position)
        if self._fault.velocity is not None:
            velocity = self._fault.velocity(velocity)
        if self._fault.delayed is not None:
            self._velocities.append(velocity)
            velocity = np.where(self._fault.delayed, self._velocities[0], velocity)
        return START + self._robot.time, position, velocity, effort

    def _answer(self, sample: Sample) -> None:
        super()._answer(sample)
        if not self.found_after and self.tracker.controller.wiring.found:
            self.found_after = len(self.log.commands) - 1
        if self._fault.effort is not None:
            self._robot.u = self._fault.effort(self.log.commands[-1][1])
        self._command = self._robot.u

    def _integrate(self, time: int) -> None:
        if self._fault.spring is None:
            super()._integrate(time)
            return
        while self._robot.time < time:
            q_l, q_m = np.split(self._robot.x[: 2 * self._n], 2)
            torque = self._fault.spring(q_m - q_l)
            self._robot.external = torque
            self._robot.u = self._command - np.linalg.solve(self._B_m, torque)
            self._robot.advance_to(self._robot.time + self._inner)
        self._robot.u = self._command
