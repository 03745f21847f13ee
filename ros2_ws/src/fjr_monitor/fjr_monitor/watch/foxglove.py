# SPDX-License-Identifier: Apache-2.0
"""`fjr watch --foxglove`: pass the topics of a running loop on to Foxglove, with the poses of the robot's links.

The optional package foxglove-sdk serves them by a WebSocket on this machine, as serialised by ROS 2. States, commands
and values of the controller are passed on 50 times a second, the newest of each topic; diagnostics and events
completely. The nodes publish no transforms, so those of the links are computed from `robot_description` and
`joint_states`. Their time is that of publication, as of the messages, which also holds where the stamps are simulated.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import closing
from types import ModuleType
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from fjr_core.errors import FjrError, RobotError
from fjr_monitor.recording.topic import definition
from fjr_monitor.scene import LinkPose, UrdfFrames
from fjr_monitor.watch.app import drained
from fjr_msgs_py import names
from fjr_msgs_py.node.participant import own_node

PORT = 8765  # Foxglove's default
PACKAGE = "foxglove-sdk"
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


class FoxgloveError(FjrError):
    """foxglove-sdk is not installed, or the port is not free."""


def serve(
    arguments: Sequence[str], controller: str, locked: Mapping[str, float], port: int, stop: threading.Event
) -> None:
    """Serve Foxglove until `stop`. Raises FoxgloveError.

    arguments: of the node, as after --ros-args. controller: name of the node that owns the ~/ topics. locked: positions
    [rad, m] of joints that the robot does not publish. port: 0 for any free one.
    """
    with (
        own_node("fjr_foxglove", list(arguments)) as node,
        closing(FoxgloveServer(node, controller, locked, port)) as server,
    ):
        print(f"open {server.address} in Foxglove (Open connection, Foxglove WebSocket); Ctrl-C ends", flush=True)
        while not stop.wait(PERIOD):
            server.forward()


class FoxgloveServer:
    """Topics of a loop, subscribed to by a node and served as they come, with one channel each."""

    def __init__(self, node: Node, controller: str, locked: Mapping[str, float], port: int) -> None:
        """For the arguments see `serve`."""
        self._node, self._controller, self._locked = node, controller, locked
        self._repeat = threading.Event()  # send the description again, which a new client did not receive
        self._sdk = sdk()
        self._sdk.set_log_level("CRITICAL")  # else each client that goes is an error on stderr
        self._context, self._channels = self._sdk.Context(), dict[str, Any]()
        self._transforms = self._sdk.channels.FrameTransformsChannel("/tf", context=self._context)
        try:
            self._server = self._sdk.start_server(
                name="fjr watch",
                host="127.0.0.1",
                port=port,
                context=self._context,
                server_listener=self._listener(),
            )
        except RuntimeError as error:
            raise FoxgloveError(f"port {port} cannot be used ({error}); expected a free one, e.g. --port 0") from None
        self.address = f"ws://localhost:{self._server.port}"
        self._newest = {topic: self._subscribe(topic, kind, best_effort(1)) for topic, kind in NEWEST.items()}
        self._every = [self._subscribe(topic, kind, best_effort(QUEUE)) for topic, kind in EVERY.items()]
        self._description = self._subscribe(names.ROBOT_DESCRIPTION, String, names.LATCHED)
        self._latest_description: tuple[bytes, int] | None = None
        self._frames: UrdfFrames | None = None

    def forward(self) -> None:
        """Pass on what has arrived."""
        for data, info in drained(self._description)[-1:]:
            self._latest_description = data, info["source_timestamp"]
            self._frames = frames_of(deserialize_message(data, String).data)
            self._repeat.set()
        if self._latest_description is not None and self._repeat.is_set():
            self._repeat.clear()
            self._send(self._description, *self._latest_description)
        for topic, subscription in self._newest.items():
            for data, info in drained(subscription)[-1:]:
                time = info["source_timestamp"]
                self._send(subscription, data, time)
                if topic == names.JOINT_STATES and self._frames is not None:
                    state = deserialize_message(data, JointState)
                    positions = dict(zip(state.name, state.position))  # noqa: B905 (a field may be empty)
                    poses = self._frames.at({**self._locked, **positions})
                    self._transforms.log(frame_transforms(poses, time), log_time=time)
        for subscription in self._every:
            for data, info in drained(subscription):
                self._send(subscription, data, info["source_timestamp"])

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()

    def _send(self, subscription: Subscription, data: bytes, time: int) -> None:
        """Send a serialised message; time [ns]: when it was published."""
        self._channels[subscription.topic_name].log(data, log_time=time)

    def _subscribe(self, topic: str, kind: type, qos: QoSProfile) -> Subscription:
        """Subscribe to a topic, and offer it to clients with the definition of its type."""
        name, type_name = topic.replace("~", self._controller), f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        subscription = self._node.create_subscription(kind, name, lambda _: None, qos, raw=True)
        schema = self._sdk.Schema(name=type_name, encoding="ros2msg", data=definition(type_name).encode())
        channel = self._sdk.Channel(
            subscription.topic_name, schema=schema, message_encoding="cdr", context=self._context
        )
        self._channels[subscription.topic_name] = channel
        return subscription

    def _listener(self) -> Any:
        """Return a listener to the subscriptions of clients, which calls from another thread."""
        repeat = self._repeat

        class Listener(self._sdk.ServerListener):  # type: ignore[name-defined]
            def on_subscribe(self, _client: Any, channel: Any) -> None:
                if str(channel.topic).endswith(names.ROBOT_DESCRIPTION):
                    repeat.set()

        return Listener()


def sdk() -> ModuleType:
    """Return the package foxglove; raise FoxgloveError if it is not installed."""
    try:
        import foxglove
    except ImportError:
        raise FoxgloveError(
            f"{PACKAGE}, which serves Foxglove, is not installed; expected it from: pip install {PACKAGE}"
        ) from None
    return foxglove


def best_effort(depth: int) -> QoSProfile:
    """Return a quality of service for which no publisher waits."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def frames_of(urdf: str) -> UrdfFrames | None:
    """Return the frames of a robot description; None for an invalid one, which is reported."""
    try:
        return UrdfFrames(urdf)
    except RobotError as error:
        print(f"fjr: no transforms: {error}", file=sys.stderr, flush=True)
        return None


def frame_transforms(frames: Sequence[LinkPose], time: int) -> Any:
    """Return frames at a time [ns] as Foxglove's message FrameTransforms."""
    messages = sdk().messages
    stamp = messages.Timestamp(sec=time // 10**9, nsec=time % 10**9)
    return messages.FrameTransforms(
        transforms=[
            messages.FrameTransform(
                timestamp=stamp,
                parent_frame_id=each.parent,
                child_frame_id=each.child,
                translation=messages.Vector3(**dict(zip("xyz", each.translation.tolist(), strict=True))),
                rotation=messages.Quaternion(**dict(zip("xyzw", each.quaternion.tolist(), strict=True))),
            )
            for each in frames
        ]
    )
