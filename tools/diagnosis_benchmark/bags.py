# SPDX-License-Identifier: Apache-2.0
"""Write runs of the labelled set to MCAP bags with the topics of the nodes, and read them back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_bringup.recording.message_types import type_hash
from fjr_bringup.recording.reader import Bag, JointTable, read_bag
from fjr_bringup.recording.writer import BagWriter
from fjr_core.config.safety import safety
from fjr_core.config.scenario import Scenario
from fjr_core.monitoring.record import Record
from fjr_msgs_py import names
from fjr_msgs_py.messages.joint_states import EffortWriter, JointStateWriter

from .loop import Log

CONTROLLER = f"/{names.CONTROLLER}"
STATES, COMMANDS, EFFORTS = (f"/{name}" for name in (names.JOINT_STATES, names.JOINT_COMMANDS, names.EFFORT_COMMANDS))
REFERENCE, ERROR = (name.replace("~", CONTROLLER) for name in (names.REFERENCE, names.TRACKING_ERROR))
TYPES = {
    STATES: JointState,
    COMMANDS: JointState,
    EFFORTS: Float64MultiArray,
    REFERENCE: JointState,
    ERROR: JointState,
}
LATENCY = 200_000  # ns; from a state to its command


class _Topics:
    """Topics of a bag with sequence numbers."""

    def __init__(self, bag: BagWriter) -> None:
        self._bag = bag
        self._channels = {topic: self._added(topic, kind.__name__) for topic, kind in TYPES.items()}

    def write(self, topic: str, time: int, data: bytes) -> None:
        """Write a message that was sent at `time` [ns]."""
        channel = self._channels[topic]
        self._bag.write(channel, time, time, channel.count + 1, data)

    def _added(self, topic: str, kind: str):  # type: ignore[no-untyped-def]
        package = "std_msgs" if kind == "Float64MultiArray" else "sensor_msgs"
        return self._bag.add_topic(topic, f"{package}/msg/{kind}", [names.LATEST], type_hash(f"{package}/msg/{kind}"))


def write_bag(log: Log, scenario: Scenario, folder: Path) -> None:
    """Write the log as a bag in `folder`, with the times of lock-step."""
    joints = scenario.joints
    writers = {topic: JointStateWriter(joints) for topic in (COMMANDS, REFERENCE, ERROR)}
    states, efforts = JointStateWriter(names.state_names(joints)), EffortWriter(joints)
    commands = {stamp: (u, jets) for stamp, u, jets in log.commands}
    bag = BagWriter(folder)
    topics = _Topics(bag)
    for time, sample in log.states:
        stamp, position, velocity, _ = sample
        topics.write(STATES, time, states.fill(*sample))
        if stamp not in commands:
            continue
        u, jets = commands.pop(stamp)
        error, n = position[: len(joints)] - jets[0], len(joints)
        topics.write(COMMANDS, time + LATENCY, writers[COMMANDS].fill(stamp, effort=u))
        topics.write(EFFORTS, time + LATENCY, efforts.fill(u))
        topics.write(REFERENCE, time + LATENCY, writers[REFERENCE].fill(stamp, jets[0], jets[1]))
        topics.write(ERROR, time + LATENCY, writers[ERROR].fill(stamp, error, velocity[:n] - jets[1]))
    bag.close()


def read_record(folder: Path, scenario: Scenario) -> Record:
    """Return the record to diagnose, from bag and scenario alone."""
    return bag_record(read_bag(folder), scenario)


def bag_record(bag: Bag, scenario: Scenario) -> Record:
    """Return the record of a bag: every stamp once, from the first command on."""
    joints, robot = scenario.joints, scenario.robot
    commands = _once(bag.joints(COMMANDS, joints))
    states = _once(bag.joints(STATES, names.state_names(joints)))
    start = commands.stamp[0]
    rows = np.flatnonzero(states.stamp >= start)
    stamps = states.stamp[rows]
    place = np.minimum(np.searchsorted(commands.stamp, stamps), len(commands.stamp) - 1)
    answered = commands.stamp[place] == stamps
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
    rows = np.unique(table.stamp, return_index=True)[1]
    return JointTable(
        *(getattr(table, name)[rows] for name in ("stamp", "publish_time", "position", "velocity", "effort"))
    )
