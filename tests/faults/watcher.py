# SPDX-License-Identifier: Apache-2.0
"""An independent watcher of plant and controller: subscribe to every topic, store every message, publish nothing."""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_msgs_py.node.participant import leave

EFFORTS, COMMANDS = "effort_controller/commands", "joint_commands"
STATES, REFERENCE = "joint_states", "fjr_controller/reference"
DIAGNOSTICS, EVENTS = "/diagnostics", "fjr_controller/events"
TRUE_STATES = "true_states"  # of the plant, if a relay is between plant and controller

KINDS: dict[str, Any] = {
    STATES: JointState,
    TRUE_STATES: JointState,
    EFFORTS: Float64MultiArray,
    COMMANDS: JointState,
    REFERENCE: JointState,
    DIAGNOSTICS: DiagnosticArray,
    EVENTS: DiagnosticStatus,
}
DEPTH = 5000  # messages of a topic between two polls: 5 s at 1 kHz


def stamp_of(raw: bytes) -> int:
    """Return the stamp of a serialised message that begins with a header [ns]."""
    sec, nanosec = struct.unpack_from("<iI", raw, 4)
    return int(sec) * 10**9 + int(nanosec)


@dataclass(frozen=True)
class Heard:
    """A serialised message and its send time [ns, system clock]."""

    topic: str
    sent: int
    raw: bytes

    @property
    def stamp(self) -> int:
        """Return the stamp of the leading header of the message [ns]."""
        return stamp_of(self.raw)

    def message(self) -> Any:
        return deserialize_message(self.raw, KINDS[self.topic])


class Watcher:
    """Store all messages in the order of arrival; `look` empties the queues."""

    def __init__(self) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node("watcher", context=self._context, enable_rosout=False)
        deep = QoSProfile(depth=DEPTH)
        self._subscriptions = {
            topic: self.node.create_subscription(kind, topic, lambda _: None, deep) for topic, kind in KINDS.items()
        }
        self.heard: dict[str, list[Heard]] = {topic: [] for topic in KINDS}

    def look(self) -> None:
        """Take all queued messages."""
        for topic, subscription in self._subscriptions.items():
            take, kind, keep = subscription.handle.take_message, KINDS[topic], self.heard[topic]
            while (taken := take(kind, True)) is not None:
                raw, info = taken
                keep.append(Heard(topic, info["source_timestamp"], raw))

    def senders(self, topic: str) -> int:
        """Return the number of publishers of a topic that are connected to this watcher."""
        return int(self._subscriptions[topic].get_publisher_count())

    def messages(self, topic: str) -> list[Any]:
        return [heard.message() for heard in self.heard[topic]]

    def counters(self, node: str) -> Counter[str]:
        """Return the latest counters that a node reported."""
        for message in reversed(self.messages(DIAGNOSTICS)):
            for status in message.status:
                if status.name.endswith(node):
                    return Counter({pair.key: int(pair.value) for pair in status.values if pair.value.isdigit()})
        return Counter()

    def close(self) -> None:
        leave(self.node)
        self._context.try_shutdown()
