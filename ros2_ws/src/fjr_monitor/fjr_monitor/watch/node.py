# SPDX-License-Identifier: Apache-2.0
"""Node of `fjr watch`: subscribe to a running loop without disturbing it.

No executor: `listen` empties the queues a few times a second. For most states only the times are read from the
serialised bytes; one message per call is deserialised. Subscriptions are best effort, so that no publisher waits for a
slow terminal.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from fjr_monitor.recording.reader import header_stamp
from fjr_monitor.watch.state import Health, Watched
from fjr_msgs_py import names
from fjr_msgs_py.node.reports import labelled

DEPTH = 4000  # messages between two calls of `listen`


class FjrWatch:
    """Subscribe with a node, under its namespace and remaps; pass all messages to `watched`."""

    def __init__(self, node: Node, watched: Watched, controller: str = names.CONTROLLER) -> None:
        """controller: name of the node that owns the ~/ topics."""
        self._node, self._watched = node, watched
        self._now = 0.0
        self._space = f"{node.get_namespace()}/".lstrip("/")
        own = {name: name.replace("~", controller) for name in (names.TRACKING_ERROR, names.CERTIFICATE, names.EVENTS)}
        self._topics: list[str] = []
        self._stamped = [
            (self._subscribe(JointState, names.JOINT_STATES), watched.sent, self._on_state),
            (self._subscribe(JointState, names.JOINT_COMMANDS), watched.answered, self._on_command),
        ]
        self._newest = [
            (
                self._subscribe(JointState, own[names.TRACKING_ERROR], 1),
                lambda m: watched.error(_by_name(m, m.position)),
            ),
            (self._subscribe(Float64MultiArray, own[names.CERTIFICATE], 1), lambda m: watched.certificate(labelled(m))),
            (self._subscribe(Float64MultiArray, names.EFFORT_COMMANDS, 1), self._on_efforts),
            (self._subscribe(String, names.ROBOT_DESCRIPTION, 1, names.LATCHED), lambda m: watched.description(m.data)),
        ]
        self._every = [
            (self._subscribe(DiagnosticArray, names.DIAGNOSTICS, 100), self._on_diagnostics),
            (self._subscribe(DiagnosticStatus, own[names.EVENTS], 100), self._on_event),
        ]
        self._joints: list[str] = []
        self._named_efforts = False

    def listen(self, now: float) -> None:
        """Process all new messages; `now` [s]: the current time."""
        self._now = now
        for subscription, on_times, on_last in self._stamped:
            taken = drained(subscription)
            on_times([(header_stamp(data), info["source_timestamp"]) for data, info in taken])
            for data, _ in taken[-1:]:
                on_last(deserialize_message(data, subscription.msg_type))
        for subscription, on_newest in self._newest:
            for data, _ in drained(subscription)[-1:]:
                on_newest(deserialize_message(data, subscription.msg_type))
        for subscription, on_each in self._every:
            for data, _ in drained(subscription):
                on_each(deserialize_message(data, subscription.msg_type))

    @property
    def waited_for(self) -> tuple[str, str]:
        """Return the topics of states and diagnostics."""
        return self._stamped[0][0].topic_name, self._every[0][0].topic_name

    def missing(self) -> list[str]:
        """Return the topics without a publisher; one of the two command topics is enough."""
        silent = [topic for topic in self._topics if not self._node.count_publishers(topic)]
        commands = {self._stamped[1][0].topic_name, self._newest[2][0].topic_name}
        return silent if commands <= set(silent) else [topic for topic in silent if topic not in commands]

    def _subscribe(self, kind: type, topic: str, depth: int = DEPTH, qos: QoSProfile | None = None) -> Subscription:
        profile = qos or QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        subscription = self._node.create_subscription(kind, topic, lambda _: None, profile, raw=True)
        self._topics.append(subscription.topic_name)
        return subscription

    def _on_state(self, message: JointState) -> None:
        self._joints = [name for name in message.name if not name.endswith(names.motor_name(""))]
        self._watched.state(self._now, _by_name(message, message.position), _by_name(message, message.velocity))

    def _on_command(self, message: JointState) -> None:
        self._named_efforts = True
        self._watched.effort(_by_name(message, message.effort))

    def _on_efforts(self, message: Float64MultiArray) -> None:
        """Use these efforts without JointState commands: by label, else in the joint order of the states."""
        if not self._named_efforts:
            in_order = dict(zip(self._joints, message.data))  # noqa: B905
            self._watched.effort(labelled(message) or in_order)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if not status.name.startswith(self._space):
                continue  # of another robot
            values = {pair.key: pair.value for pair in status.values}
            health = Health(status.name, status.level[0], status.message, values.get("state", ""))
            self._watched.health(self._now, health)

    def _on_event(self, message: DiagnosticStatus) -> None:
        self._watched.event(self._now, message.level[0], message.name, message.message)


def _by_name(message: JointState, values: Sequence[float]) -> dict[str, float]:
    return dict(zip(message.name, values))  # noqa: B905 (a field may be empty)


def drained(subscription: Subscription) -> list[tuple[bytes, Any]]:
    """Empty a queue; return the serialised messages with their infos."""
    found = []
    while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
        found.append(taken)
    return found
