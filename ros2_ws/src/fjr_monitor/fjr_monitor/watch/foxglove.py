# SPDX-License-Identifier: Apache-2.0
"""`fjr watch --foxglove`: pass the topics of a running loop on to Foxglove, with the poses of the robot's links.

States, commands and values of the controller are passed on 50 times a second, the newest of each topic; diagnostics and
events completely. The nodes publish no transforms, so those of the links are computed from `robot_description` and
`joint_states`. Their time is that of publication, as of the messages, which also holds where the stamps are simulated.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Mapping
from contextlib import closing

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from fjr_core.errors import RobotError
from fjr_core.urdf.tree import UrdfFrames
from fjr_monitor.watch.app import Options
from fjr_monitor.watch.foxglove_server import PORT, FoxgloveServer
from fjr_monitor.watch.node import drained
from fjr_msgs_py import names
from fjr_msgs_py.node.participant import own_node

__all__ = ["PORT", "serve"]

PERIOD = 0.02  # s between two messages of a topic
NEWEST = {
    names.JOINT_STATES: JointState,
    names.JOINT_COMMANDS: JointState,
    names.EFFORT_COMMANDS: Float64MultiArray,
    names.REFERENCE: JointState,
    names.TRACKING_ERROR: JointState,
    names.CERTIFICATE: Float64MultiArray,
}
EVERY = {names.DIAGNOSTICS: DiagnosticArray, names.EVENTS: DiagnosticStatus}
QUEUE = 100  # diagnostics and events between two calls


def serve(options: Options, locked: Mapping[str, float], port: int, stop: threading.Event) -> None:
    """Serve Foxglove until `stop`. Raises FoxgloveError.

    locked: positions [rad, m] of joints that the robot does not publish. port: 0 for any free one.
    """
    with (
        own_node("fjr_foxglove", options.arguments) as node,
        closing(Bridge(node, options.controller, locked, port)) as bridge,
    ):
        print(f"open {bridge.address} in Foxglove (Open connection, Foxglove WebSocket); Ctrl-C ends", flush=True)
        while not stop.wait(PERIOD):
            bridge.forward()


class Bridge:
    """Subscriptions of a node, passed on to a server."""

    def __init__(self, node: Node, controller: str, locked: Mapping[str, float], port: int) -> None:
        """controller: name of the node that owns the ~/ topics. locked, port: as of `serve`."""
        self._repeat = threading.Event()
        self._server = FoxgloveServer(port, self._on_subscription)
        self.address = self._server.address
        self._node, self._controller, self._locked = node, controller, locked
        self._newest = {topic: self._subscribe(topic, kind, _best_effort(1)) for topic, kind in NEWEST.items()}
        self._every = [self._subscribe(topic, kind, _best_effort(QUEUE)) for topic, kind in EVERY.items()]
        self._description = self._subscribe(names.ROBOT_DESCRIPTION, String, names.LATCHED)
        self._latest_description: tuple[bytes, int] | None = None
        self._frames: UrdfFrames | None = None

    def forward(self) -> None:
        """Pass on what has arrived."""
        self._forward_description()
        for topic, subscription in self._newest.items():
            for data, info in drained(subscription)[-1:]:
                self._server.send(subscription.topic_name, data, info["source_timestamp"])
                if topic == names.JOINT_STATES and self._frames is not None:
                    self._send_frames(self._frames, data, info["source_timestamp"])
        for subscription in self._every:
            for data, info in drained(subscription):
                self._server.send(subscription.topic_name, data, info["source_timestamp"])

    def close(self) -> None:
        """Stop the server."""
        self._server.close()

    def _subscribe(self, topic: str, kind: type, qos: QoSProfile) -> Subscription:
        name = topic.replace("~", self._controller)
        subscription = self._node.create_subscription(kind, name, lambda _: None, qos, raw=True)
        self._server.add(subscription.topic_name, f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}")
        return subscription

    def _on_subscription(self, topic: str) -> None:
        """Have the description sent again, because a new client did not receive the first one."""
        if topic.endswith(names.ROBOT_DESCRIPTION):
            self._repeat.set()

    def _forward_description(self) -> None:
        for data, info in drained(self._description)[-1:]:
            self._latest_description = data, info["source_timestamp"]
            self._frames = _frames(deserialize_message(data, String).data)
            self._repeat.set()
        if self._latest_description is not None and self._repeat.is_set():
            self._repeat.clear()
            self._server.send(self._description.topic_name, *self._latest_description)

    def _send_frames(self, frames: UrdfFrames, data: bytes, time: int) -> None:
        state = deserialize_message(data, JointState)
        positions = dict(zip(state.name, state.position))  # noqa: B905 (a field may be empty)
        self._server.send_frames(frames.at({**self._locked, **positions}), time)


def _best_effort(depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def _frames(urdf: str) -> UrdfFrames | None:
    """Return the frames of a robot description; None for an invalid one, which is reported."""
    try:
        return UrdfFrames(urdf)
    except RobotError as error:
        print(f"fjr: no transforms: {error}", file=sys.stderr, flush=True)
        return None
