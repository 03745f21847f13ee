# SPDX-License-Identifier: Apache-2.0
"""Serve messages to Foxglove by a WebSocket on this machine, with the optional package foxglove-sdk. No ROS node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

from fjr_core.errors import FjrError
from fjr_core.urdf.tree import LinkPose
from fjr_monitor.recording.message_types import definition

PORT = 8765  # Foxglove's default
TRANSFORMS = "/tf"
PACKAGE = "foxglove-sdk"


class FoxgloveError(FjrError):
    """foxglove-sdk is not installed, or the port is not free."""


def _sdk() -> ModuleType:
    try:
        import foxglove
    except ImportError:
        raise FoxgloveError(
            f"{PACKAGE}, which serves Foxglove, is not installed; expected it from: pip install {PACKAGE}"
        ) from None
    return foxglove


class FoxgloveServer:
    """A server with one channel per topic; messages are passed on as serialised by ROS 2 (encoding cdr)."""

    def __init__(self, port: int, on_subscription: Callable[[str], None]) -> None:
        """port: 0 for any free one. on_subscription: called by another thread with a topic that a client subscribes."""
        self._sdk = _sdk()
        self._sdk.set_log_level("CRITICAL")  # else each client that goes is an error on stderr
        self._context, self._channels = self._sdk.Context(), dict[str, Any]()
        self._frames = self._sdk.channels.FrameTransformsChannel(TRANSFORMS, context=self._context)
        try:
            self._server = self._sdk.start_server(
                name="fjr watch",
                host="127.0.0.1",
                port=port,
                context=self._context,
                server_listener=_listener(self._sdk, on_subscription),
            )
        except RuntimeError as error:
            raise FoxgloveError(f"port {port} cannot be used ({error}); expected a free one, e.g. --port 0") from None

    @property
    def address(self) -> str:
        """Address for Foxglove's dialog `Open connection`."""
        return f"ws://localhost:{self._server.port}"

    def add(self, topic: str, type_name: str) -> None:
        """Advertise a topic with the definition of its type, e.g. sensor_msgs/msg/JointState."""
        schema = self._sdk.Schema(name=type_name, encoding="ros2msg", data=definition(type_name).encode())
        self._channels[topic] = self._sdk.Channel(topic, schema=schema, message_encoding="cdr", context=self._context)

    def send(self, topic: str, data: bytes, time: int) -> None:
        """Send a serialised message; time [ns]: when it was published."""
        self._channels[topic].log(data, log_time=time)

    def send_frames(self, frames: Sequence[LinkPose], time: int) -> None:
        """Send the poses of the links at a time [ns]."""
        self._frames.log(frame_transforms(frames, time), log_time=time)

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()


def _listener(sdk: ModuleType, on_subscription: Callable[[str], None]) -> Any:
    class Listener(sdk.ServerListener):  # type: ignore[name-defined]
        def on_subscribe(self, _client: Any, channel: Any) -> None:
            on_subscription(str(channel.topic))

    return Listener()


def frame_transforms(frames: Sequence[LinkPose], time: int) -> Any:
    """Return frames as Foxglove's message FrameTransforms."""
    messages = _sdk().messages
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
