# SPDX-License-Identifier: Apache-2.0
"""Write runs of the labelled set to MCAP bags with the topics of the nodes; the product reads them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.recording.message_types import type_hash
from fjr_monitor.recording.recorder import BagWriter
from fjr_monitor.recording.run import Recording
from fjr_monitor.recording.signals import ANSWERS, EFFORTS, REFERENCE, STATES
from fjr_monitor.report.contact import TOPIC as CONTACT
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr import FIELDS, HEADER, Form, float_array, joint_state

from .lock_step import LockStepLoop

TYPES = dict.fromkeys((STATES, ANSWERS, EFFORTS, REFERENCE, CONTACT), "sensor_msgs/msg/JointState")
TYPES[EFFORTS] = "std_msgs/msg/Float64MultiArray"
LATENCY = 200_000  # ns; from a state to its command
WHOLE = 1_000_000  # states of a part


def read_record(folder: Path, scenario: Scenario) -> Record:
    """Return the run in a bag as one record."""
    return next(Recording(read_bag(folder), scenario, size=WHOLE).parts())


def write_bag(loop: LockStepLoop, folder: Path) -> None:
    """Write a run as a bag in `folder`, with the times of lock-step."""
    joints, n = list(loop.scenario.joints), loop.scenario.robot.n
    commands = {stamp: (u, jets) for stamp, u, jets in loop.commands}
    bag = BagWriter(folder)
    channels = {topic: bag.add_topic(topic, kind, [names.LATEST], type_hash(kind)) for topic, kind in TYPES.items()}

    def write(topic: str, time: int, data: bytes) -> None:
        bag.write(channels[topic], time, time, channels[topic].count + 1, data)

    for time, (stamp, position, velocity, effort) in loop.states:
        states = names.state_names(loop.scenario.joints)
        write(STATES, time, _joint_state(states, stamp, position=position, velocity=velocity, effort=effort))
        if stamp in commands:
            u, jets = commands.pop(stamp)
            write(ANSWERS, time + LATENCY, _joint_state(joints, stamp, effort=u))
            write(EFFORTS, time + LATENCY, _filled(float_array(",".join(joints), n), [u]))
            write(REFERENCE, time + LATENCY, _joint_state(joints, stamp, position=jets[0], velocity=jets[1]))
    for stamp, values in loop.contacts:
        write(CONTACT, stamp, _joint_state([*joints, *names.WRENCH], stamp, effort=values))
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
