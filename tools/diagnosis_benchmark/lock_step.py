# SPDX-License-Identifier: Apache-2.0
"""Run plant and controller in lock-step without ROS, with a fault: robot, message channels and tracker in one process.

The code is that of the nodes (fjr_plant.simulated_robot, fjr_core.runtime.control_step), about a hundred times
faster and reproducible to the bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from fjr_core import StateError
from fjr_core.config.scenario import Scenario
from fjr_core.model.joints import JointSample
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.recording.message_types import type_hash
from fjr_monitor.recording.recorder import BagWriter
from fjr_monitor.recording.run import Recording
from fjr_monitor.recording.signals import ANSWERS, EFFORTS, REFERENCE, STATES
from fjr_monitor.report.contact import TOPIC as CONTACT
from fjr_msgs_py import names
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

TYPES = dict.fromkeys((STATES, ANSWERS, EFFORTS, REFERENCE, CONTACT), "sensor_msgs/msg/JointState")
TYPES[EFFORTS] = "std_msgs/msg/Float64MultiArray"
MESSAGES = get_typestore(Stores.ROS2_JAZZY)
NOTHING: Array = np.zeros(0)
LATENCY = 200_000  # ns; from a state to its command


def read_record(folder: Path, scenario: Scenario) -> Record:
    """Return the run in a bag as one record."""
    recording = Recording(read_bag(folder), scenario)
    return recording.part(0, len(recording))


def write_bag(loop: LockStepLoop, folder: Path) -> None:
    """Write a run as a bag in `folder`, with the times of lock-step."""
    joints = loop.scenario.joints
    commands = {stamp: (u, jets) for stamp, u, jets in loop.commands}
    bag = BagWriter(folder)
    channels = {topic: bag.add_topic(topic, kind, [names.LATEST], type_hash(kind)) for topic, kind in TYPES.items()}

    def write(topic: str, time: int, message: Any) -> None:
        data = MESSAGES.serialize_cdr(message, TYPES[topic])
        bag.write(channels[topic], time, time, channels[topic].count + 1, bytes(data))

    for time, (stamp, position, velocity, effort) in loop.states:
        write(STATES, time, _joint_state(names.state_names(joints), stamp, position, velocity, effort))
        if stamp in commands:
            u, jets = commands.pop(stamp)
            write(ANSWERS, time + LATENCY, _joint_state(joints, stamp, effort=u))
            write(EFFORTS, time + LATENCY, _efforts(joints, u))
            write(REFERENCE, time + LATENCY, _joint_state(joints, stamp, jets[0], jets[1]))
    for stamp, values in loop.contacts:
        write(CONTACT, stamp, _joint_state([*joints, *names.WRENCH], stamp, effort=values))
    bag.close()


def _joint_state(
    joints: Sequence[str], stamp: int, position: Array = NOTHING, velocity: Array = NOTHING, effort: Array = NOTHING
) -> Any:
    types = MESSAGES.types
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
    header = types["std_msgs/msg/Header"](time, "")
    return types["sensor_msgs/msg/JointState"](header, list(joints), position, velocity, effort)


def _efforts(joints: Sequence[str], u: Array) -> Any:
    types, n = MESSAGES.types, len(joints)
    layout = types["std_msgs/msg/MultiArrayDimension"](",".join(joints), n, n)
    return types["std_msgs/msg/Float64MultiArray"](types["std_msgs/msg/MultiArrayLayout"]([layout], 0), u)
