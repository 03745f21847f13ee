# SPDX-License-Identifier: Apache-2.0
"""Run plant and controller in lock-step without ROS: simulated robot, message channels and tracker in one process.

The code is that of the nodes (fjr_plant.lock_step, fjr_controller.command_loop), about a hundred times
faster and reproducible to the bit.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from fjr_core import StateError
from fjr_core.config.controller import safety
from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.measurement_model import JointSample
from fjr_monitor.diagnosis.record import Record
from fjr_plant.lock_step import START
from fjr_plant.simulated_robot import simulated

Sample = tuple[int, Array, Array, Array]
"""Stamp [ns], positions, velocities and efforts, (2n,) each."""
LARGEST = 1e6  # rad; beyond this position the loop has diverged


@dataclass
class Log:
    """Messages of the run: states as (send time [ns], sample), commands as (stamp, u, jets)."""

    states: list[tuple[int, Sample]] = field(default_factory=list)
    commands: list[tuple[int, Array, Array]] = field(default_factory=list)


class LockStepLoop:
    """Run a scenario in lock-step; raise ParameterError for invalid values."""

    def __init__(self, scenario: Scenario) -> None:
        self._robot, self._transport = simulated(scenario.plant_values, scenario.plant, scenario.x0)
        self._n = scenario.robot.n
        settings = safety(scenario.controller_values, scenario.robot)
        self.tracker = ControlStep(scenario.law, scenario.reference, settings, simulated=True)
        self._arrived: deque[Sample] = deque()
        self._newest = 0
        self.log = Log()

    def run(self, duration: float) -> Log:
        """Run for `duration` [s] or until the loop diverges; return the log."""
        end = round(duration * 1e9)
        self._arrived.append(self._sample())
        try:
            while self._robot.time < end and np.abs(self._robot.x).max() < LARGEST:
                self._process_arrived()
                self._integrate(self._transport.times.next())
                self._measure()
        except StateError:
            pass  # diverged
        return self.log

    def _sample(self) -> Sample:
        return START + self._robot.time, *self._robot.measure()

    def _measure(self) -> None:
        channel = self._transport.states
        if not channel.on:
            self._arrived.append(self._sample())
        else:
            stamp, *values = self._sample()
            channel.push(self._robot.time, np.concatenate([[stamp, 1.0], *values]))
            for item in channel.due(self._robot.time):
                self._arrived.append((int(item[0]), *item[2:].reshape(3, -1)))

    def _process_arrived(self) -> None:
        while self._arrived:
            sample = self._arrived.popleft()
            self.log.states.append((START + self._robot.time, sample))
            if sample[0] >= self._newest:
                self._newest = sample[0]
                self._answer(sample)

    def _answer(self, sample: Sample) -> None:
        stamp, position, velocity, _ = sample
        sides = position[: self._n], position[self._n :], velocity[: self._n], velocity[self._n :]
        command = self.tracker.command(JointSample(stamp, *sides), stamp)
        if command is None:
            return
        self.log.commands.append((stamp, command.u.copy(), command.jets.copy()))
        if not self._transport.commands.on:
            self._robot.u = command.u.copy()
        else:
            self._transport.commands.push(self._robot.time, command.u.copy())
        self.tracker.check_wiring()

    def _integrate(self, time: int) -> None:
        commands = self._transport.commands
        while (instant := commands.next_due) is not None and instant <= time:
            self._robot.advance_to(instant)
            for self._robot.u in commands.due(instant):
                pass
        self._robot.advance_to(time)


def record(log: Log, scenario: Scenario) -> Record:
    """Return the record of a log, to be diagnosed without a bag."""
    n, limits = scenario.robot.n, safety(scenario.controller_values, scenario.robot)
    first = {stamp: (position, velocity, effort) for _, (stamp, position, velocity, effort) in reversed(log.states)}
    commands = {stamp: (u, jets) for stamp, u, jets in reversed(log.commands)}
    stamps = sorted(first)
    t = (np.array(stamps) - stamps[0]) * 1e-9
    unknown = np.full(n, np.nan)
    return Record(
        t=t,
        position=np.array([first[stamp][0] for stamp in stamps]),
        velocity=np.array([first[stamp][1] for stamp in stamps]),
        jets=np.array([scenario.reference.jets(instant) for instant in t]),
        u=np.array([commands[stamp][0] if stamp in commands else unknown for stamp in stamps]),
        u_applied=np.array([np.linalg.solve(scenario.robot.B_m, first[stamp][2][n:]) for stamp in stamps]),
        sent=None,
        answered=None,
        sample_period=scenario.sample_period,
        effort_limit=np.asarray(limits.effort),
    )
