# SPDX-License-Identifier: Apache-2.0
"""Run plant and controller in lock-step without ROS, with a fault: robot, message channels and tracker in one process.

The code is that of the nodes (fjr_plant.simulated_robot, fjr_core.runtime.control_step), about a hundred times
faster and reproducible to the bit.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fjr_core import StateError
from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_core.runtime.measurement_model import JointSample
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.recording.message_types import type_hash
from fjr_monitor.recording.recorder import BagWriter
from fjr_monitor.recording.run import Recording
from fjr_monitor.recording.signals import ANSWERS, EFFORTS, REFERENCE, STATES
from fjr_monitor.report.contact import TOPIC as CONTACT
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr import HEADER, float_array, joint_state
from fjr_plant.lock_step import START
from fjr_plant.simulated_robot import simulated

Sample = tuple[int, Array, Array, Array]
"""Stamp [ns], positions, velocities and efforts, (2n,) each."""
LARGEST = 1e6  # rad; beyond this position the loop has diverged
Change = Callable[[Array], Array]


@dataclass(frozen=True)
class Fault:
    """A fault that is no plant parameter: changes of measured position, velocity (2n,) and of the acting effort (n,).

    spring: deflection (n,) -> torque (n,) [N m] on the links in addition to K zeta, with its reaction on the motors.
    push (n,) [N m]: on the links. delay: of the velocities that are `delayed` (2n,), in samples.
    """

    position: Change | None = None
    velocity: Change | None = None
    effort: Change | None = None
    spring: Change | None = None
    push: Array | None = None
    delay: int = 0
    delayed: NDArray[np.bool_] | None = None


NONE = Fault()


class LockStepLoop:
    """A scenario in lock-step with a fault; raises ParameterError for invalid values.

    states: messages as (send time [ns], sample); commands: as (stamp, u, jets). links: true link positions (n,) [rad]
    by stamp. contacts: (stamp, torques and wrench by the obstacle) while it touches. found_after: samples before the
    state that reveals a wiring fault, 0: none found.
    """

    def __init__(self, scenario: Scenario, fault: Fault = NONE) -> None:
        self.scenario, self._fault, self._n = scenario, fault, scenario.robot.n
        self._robot, self._transport = simulated(scenario.plant_values, scenario.plant, scenario.x0)
        self.tracker = scenario.control_step(simulated=True)
        self._arrived: deque[Sample] = deque()
        self._velocities: deque[Array] = deque(maxlen=fault.delay + 1)  # the latest ones
        self._newest = self.found_after = 0
        self.states: list[tuple[int, Sample]] = []
        self.commands: list[tuple[int, Array, Array]] = []
        self.links: dict[int, Array] = {}
        self.contacts: list[tuple[int, Array]] = []
        if fault.push is not None:
            self._robot.external = fault.push

    def run(self, duration: float) -> LockStepLoop:
        """Run for `duration` [s] or until the loop diverges; return the loop."""
        end = round(duration * 1e9)
        self._arrived.append(self._sample())
        try:
            while self._robot.time < end and np.abs(self._robot.x).max() < LARGEST:
                self._process_arrived()
                self._integrate(self._transport.times.next())
                self._measure()
        except StateError:
            pass  # diverged
        return self

    def record(self) -> Record:
        """Return the record of the run, to be diagnosed without a bag."""
        robot, unknown = self.scenario.robot, np.full(self._n, np.nan)
        first = {sample[0]: sample[1:] for _, sample in reversed(self.states)}
        commands = {stamp: u for stamp, u, _ in reversed(self.commands)}
        stamps = sorted(first)
        t = (np.array(stamps) - stamps[0]) * 1e-9
        position, velocity, effort = (np.array([first[stamp][k] for stamp in stamps]) for k in range(3))
        return Record(
            t=t,
            position=position,
            velocity=velocity,
            jets=np.asarray(self.scenario.reference.jets(t)),
            u=np.array([commands.get(stamp, unknown) for stamp in stamps]),
            u_applied=np.asarray(np.linalg.solve(robot.B_m, effort[:, self._n :].T).T),
            sent=None,
            answered=None,
            sample_period=self.scenario.sample_period,
            effort_limit=np.asarray(self.scenario.settings.effort),
        )

    def _sample(self) -> Sample:
        """Return what the sensors measure now."""
        fault, (position, velocity, effort) = self._fault, self._robot.measure()
        position = fault.position(position) if fault.position else position
        velocity = fault.velocity(velocity) if fault.velocity else velocity
        if fault.delayed is not None:
            self._velocities.append(velocity)
            velocity = np.where(fault.delayed, self._velocities[0], velocity)
        stamp = START + self._robot.time
        self.links[stamp] = self._robot.x[: self._n]
        if (contact := self._robot.contact).any():
            self.contacts.append((stamp, contact))
        return stamp, position, velocity, effort

    def _measure(self) -> None:
        channel, sample = self._transport.states, self._sample()
        if not channel.on:
            self._arrived.append(sample)
            return
        channel.push(self._robot.time, np.concatenate([[sample[0], 1.0], *sample[1:]]))
        for item in channel.due(self._robot.time):
            self._arrived.append((int(item[0]), *item[2:].reshape(3, -1)))

    def _process_arrived(self) -> None:
        while self._arrived:
            sample = self._arrived.popleft()
            self.states.append((START + self._robot.time, sample))
            if sample[0] >= self._newest:
                self._newest = sample[0]
                self._answer(sample)

    def _answer(self, sample: Sample) -> None:
        (stamp, position, velocity, _), n = sample, self._n
        sides = (values for both in (position, velocity) for values in (both[:n], both[n:]))
        command = self.tracker.command(JointSample(stamp, *sides), stamp)
        if command is None:
            return
        u = command.u.copy()
        self.commands.append((stamp, u, command.jets.copy()))
        acting = self._fault.effort(u) if self._fault.effort else u.copy()
        if self._transport.commands.on:
            self._transport.commands.push(self._robot.time, acting)
        else:
            self._robot.u = acting
        self.tracker.check_wiring()
        if not self.found_after and self.tracker.controller.wiring.found:
            self.found_after = len(self.commands) - 1

    def _integrate(self, time: int) -> None:
        commands = self._transport.commands
        while (instant := commands.next_due) is not None and instant <= time:
            self._advance(instant)
            for self._robot.u in commands.due(instant):
                pass
        self._advance(time)

    def _advance(self, time: int) -> None:
        """Integrate up to `time` [ns]; the torque of the fault's spring is held during an inner step."""
        if self._fault.spring is None:
            self._robot.advance_to(time)
            return
        u, steps = self._robot.u, self.scenario.inner_steps
        while self._robot.time < time:
            q_l, q_m = np.split(self._robot.x[: 2 * self._n], 2)
            torque = self._robot.external = self._fault.spring(q_m - q_l)
            self._robot.u = u - np.linalg.solve(self.scenario.plant.robot.B_m, torque)
            self._robot.advance_to(self._robot.time + self._transport.period // steps)
        self._robot.u = u


# Bags of such loops with the topics of the nodes; the product reads them.

LATENCY = 200_000  # ns; from a state to its command


def read_record(folder: Path, scenario: Scenario) -> Record:
    """Return the run in a bag as one record."""
    recording = Recording(read_bag(folder), scenario)
    return recording.part(0, len(recording))


def write_bag(loop: LockStepLoop, folder: Path) -> None:
    """Write a run as a bag in `folder`, with the times of lock-step."""
    bag, joints, n = BagWriter(folder), loop.scenario.joints, len(loop.scenario.joints)
    measured = map(len, loop.states[0][1][1:])
    forms = {
        STATES: joint_state(names.state_names(joints), measured),
        ANSWERS: joint_state(joints, (0, 0, n)),
        EFFORTS: float_array(",".join(joints), n),
        REFERENCE: joint_state(joints, (n, n, 0)),
        CONTACT: joint_state([*joints, *names.WRENCH], (0, 0, n + len(names.WRENCH))),
    }
    kinds = dict.fromkeys(forms, "sensor_msgs/msg/JointState") | {EFFORTS: "std_msgs/msg/Float64MultiArray"}
    channels = {topic: bag.add_topic(topic, kind, [names.LATEST], type_hash(kind)) for topic, kind in kinds.items()}

    def write(topic: str, time: int, stamp: int, *numbers: Array) -> None:
        form, channel = forms[topic], channels[topic]
        data, places = bytearray(form.empty), [k for k, length in zip(form.starts, form.lengths, strict=True) if length]
        if topic != EFFORTS:
            struct.pack_into("<iI", data, HEADER, *divmod(stamp, 1_000_000_000))
        for place, values in zip(places, numbers, strict=True):
            struct.pack_into(f"<{len(values)}d", data, 8 * place - HEADER, *values)
        bag.write(channel, time, time, channel.count + 1, bytes(data))

    commands = {stamp: (u, jets) for stamp, u, jets in loop.commands}
    for time, (stamp, *sensed) in loop.states:
        write(STATES, time, stamp, *(values for values in sensed if len(values)))
        if stamp in commands:
            u, jets = commands.pop(stamp)
            write(ANSWERS, time + LATENCY, stamp, u)
            write(EFFORTS, time + LATENCY, stamp, u)
            write(REFERENCE, time + LATENCY, stamp, jets[0], jets[1])
    for stamp, values in loop.contacts:
        write(CONTACT, stamp, stamp, values)
    bag.close()
