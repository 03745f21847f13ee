# SPDX-License-Identifier: Apache-2.0
"""Write runs of the labelled set to MCAP bags with the topics of the nodes, and read them back."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from fjr_core.config.controller import safety
from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.recording.bag import JointTable, read_bag
from fjr_monitor.recording.recorder import BagWriter
from fjr_monitor.recording.signals import first_of_each_stamp, match_stamps
from fjr_monitor.recording.topic import type_hash
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr import FIELDS, HEADER, Form, float_array, joint_state

from .loop import Log

CONTROLLER = f"/{names.CONTROLLER}"
STATES, COMMANDS, EFFORTS = (f"/{name}" for name in (names.JOINT_STATES, names.JOINT_COMMANDS, names.EFFORT_COMMANDS))
REFERENCE, ERROR = (name.replace("~", CONTROLLER) for name in (names.REFERENCE, names.TRACKING_ERROR))
TYPES = dict.fromkeys((STATES, COMMANDS, EFFORTS, REFERENCE, ERROR), "sensor_msgs/msg/JointState")
TYPES[EFFORTS] = "std_msgs/msg/Float64MultiArray"
LATENCY = 200_000  # ns; from a state to its command


class _Topics:
    """Topics of a bag with sequence numbers."""

    def __init__(self, bag: BagWriter) -> None:
        self._bag = bag
        self._channels = {
            topic: bag.add_topic(topic, kind, [names.LATEST], type_hash(kind)) for topic, kind in TYPES.items()
        }

    def write(self, topic: str, time: int, data: bytes) -> None:
        """Write a message that was sent at `time` [ns]."""
        channel = self._channels[topic]
        self._bag.write(channel, time, time, channel.count + 1, data)


def write_bag(log: Log, scenario: Scenario, folder: Path) -> None:
    """Write the log as a bag in `folder`, with the times of lock-step."""
    joints, n = list(scenario.joints), len(scenario.joints)
    commands = {stamp: (u, jets) for stamp, u, jets in log.commands}
    bag = BagWriter(folder)
    topics = _Topics(bag)
    for time, (stamp, position, velocity, effort) in log.states:
        states = names.state_names(scenario.joints)
        topics.write(STATES, time, _joint_state(states, stamp, position=position, velocity=velocity, effort=effort))
        if stamp not in commands:
            continue
        u, jets = commands.pop(stamp)
        error = {"position": position[:n] - jets[0], "velocity": velocity[:n] - jets[1]}
        topics.write(COMMANDS, time + LATENCY, _joint_state(joints, stamp, effort=u))
        topics.write(EFFORTS, time + LATENCY, _filled(float_array(",".join(joints), n), [u]))
        reference = _joint_state(joints, stamp, position=jets[0], velocity=jets[1])
        topics.write(REFERENCE, time + LATENCY, reference)
        topics.write(ERROR, time + LATENCY, _joint_state(joints, stamp, **error))
    bag.close()


def _joint_state(joints: list[str], stamp: int, **fields: Array) -> bytes:
    values = [fields.get(name, np.zeros(0)) for name in FIELDS]
    return _filled(joint_state(joints, map(len, values)), values, stamp)


def _filled(form: Form, values: list[Array], stamp: int | None = None) -> bytes:
    """Return a message without trailing bytes, which rosbags refuses; rclpy may append some."""
    data = bytearray(HEADER) + form.empty
    if stamp is not None:
        struct.pack_into("<iI", data, 2 * HEADER, *divmod(stamp, 1_000_000_000))
    for start, numbers in zip(form.starts, values, strict=True):
        data[8 * start : 8 * (start + len(numbers))] = np.asarray(numbers, dtype="<f8").tobytes()
    return bytes(data[HEADER:])


def read_record(folder: Path, scenario: Scenario) -> Record:
    """Return the record to diagnose, from bag and scenario alone: every stamp once, from the first command on."""
    bag, joints, robot = read_bag(folder), scenario.joints, scenario.robot
    commands = _once(bag.joints(COMMANDS, joints))
    states = _once(bag.joints(STATES, names.state_names(joints)))
    start = commands.stamp[0]
    rows = np.flatnonzero(states.stamp >= start)
    stamps = states.stamp[rows]
    place, answered = match_stamps(stamps, commands.stamp)
    t = (stamps - start) * 1e-9
    return Record(
        t=t,
        position=states.position[rows],
        velocity=states.velocity[rows],
        jets=np.asarray(scenario.reference.jets(t)),
        u=np.where(answered[:, None], commands.effort[place], np.nan),
        u_applied=np.asarray(np.linalg.solve(robot.B_m, states.effort[rows, robot.n :].T).T),
        sent=None,  # in lock-step send times carry no information
        answered=None,
        sample_period=scenario.sample_period,
        effort_limit=np.asarray(safety(scenario.controller_values, robot).effort),
    )


def _once(table: JointTable) -> JointTable:
    """Return the first message of each stamp, sorted by stamp."""
    rows = first_of_each_stamp(table.stamp)
    return JointTable(**{name: values[rows] for name, values in vars(table).items()})
