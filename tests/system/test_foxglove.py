# SPDX-License-Identifier: Apache-2.0
"""`fjr watch --foxglove` with running nodes and a WebSocket client that speaks Foxglove's protocol."""

from __future__ import annotations

import json
import signal
import socket
import struct
import sys
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from websockets.sync.client import ClientConnection, connect

from fjr_core.urdf.tree import UrdfFrames
from fjr_monitor.watch.foxglove import FoxgloveError, FoxgloveServer, frame_transforms
from system.executables import TIME_LIMIT, Executable, fjr_here, lockstep_loop, wait_for
from time_limits import Limit

pytestmark = pytest.mark.system
MESSAGE = struct.Struct("<BIQ")  # opcode 1, subscription, time [ns]; then the payload
STATES, DESCRIPTION, TRANSFORMS = "/left/joint_states", "/left/robot_description", "/tf"
STATE, ARRAY, STATUS = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray", "diagnostic_msgs/msg/Diagnostic"
TYPES = {
    STATES: STATE,
    "/left/joint_commands": STATE,
    "/left/effort_controller/commands": ARRAY,
    "/left/fjr_controller/reference": STATE,
    "/left/fjr_controller/tracking_error": STATE,
    "/left/fjr_controller/certificate": ARRAY,
    DESCRIPTION: "std_msgs/msg/String",
    "/diagnostics": f"{STATUS}Array",
    "/left/fjr_controller/events": f"{STATUS}Status",
    TRANSFORMS: "foxglove.FrameTransforms",
}
SPORADIC = "/left/fjr_controller/events"


class Client:
    """A client that subscribes to everything; `heard`: payloads by topic and time [ns]."""

    def __init__(self, address: str) -> None:
        self._socket: ClientConnection = connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None)
        self.channels: dict[int, dict[str, Any]] = {}
        self.heard: dict[str, dict[int, bytes]] = {}

    def until_heard(self, *topics: str) -> None:
        limit = Limit(TIME_LIMIT)
        while not set(topics) <= set(self.heard):
            assert not limit.passed(), set(topics) - set(self.heard)
            self._receive()

    def _receive(self) -> None:
        message = self._socket.recv(timeout=TIME_LIMIT)
        if isinstance(message, bytes):
            _, channel, time = MESSAGE.unpack_from(message)
            self.heard.setdefault(self.channels[channel]["topic"], {})[time] = message[MESSAGE.size :]
            return
        for channel in json.loads(message).get("channels", []):
            self.channels[channel["id"]] = channel
            wish = {"id": channel["id"], "channelId": channel["id"]}
            self._socket.send(json.dumps({"op": "subscribe", "subscriptions": [wish]}))

    def close(self) -> None:
        self._socket.close()


@pytest.fixture(scope="module")
def watch() -> Iterator[Executable]:
    """`fjr watch` next to two nodes in a namespace."""
    with lockstep_loop("two_link", "left"):
        shown = Executable("fjr_bringup", "fjr", "watch", "--namespace", "left", "--foxglove", "--port", "0")
        yield shown
        shown.kill()


def address(watch: Executable) -> str:
    wait_for(lambda: "ws://" in watch.said_so_far(), "the address")
    return next(word for word in watch.said_so_far().split() if word.startswith("ws://"))


def test_client_receives_states_transforms_and_description_of_the_running_loop(watch: Executable) -> None:
    client = Client(address(watch))
    client.until_heard(*(set(TYPES) - {SPORADIC}))
    assert {each["topic"]: each["schemaName"] for each in client.channels.values()} == TYPES
    states = next(each for each in client.channels.values() if each["topic"] == STATES)
    assert (states["encoding"], states["schemaEncoding"]) == ("cdr", "ros2msg")
    assert "float64[] position" in states["schema"]
    urdf = deserialize_message(next(iter(client.heard[DESCRIPTION].values())), String).data
    assert {link.get("name") for link in ElementTree.fromstring(urdf).iter("link")} > {"base_link"}
    time, transforms = next(iter(client.heard[TRANSFORMS].items()))
    state = deserialize_message(client.heard[STATES][time], JointState)
    assert state.name == ["shoulder", "elbow", "shoulder_motor", "elbow_motor"]
    positions = dict(zip(state.name, state.position, strict=True))
    assert transforms == frame_transforms(UrdfFrames(urdf).at(positions), time).encode()
    client.close()


def test_late_client_receives_the_description_and_ctrl_c_ends(watch: Executable) -> None:
    client = Client(address(watch))
    client.until_heard(DESCRIPTION)
    client.close()
    watch.signal(signal.SIGINT)
    code, said = watch.end()
    assert code == 0
    assert len(said.splitlines()) == 1, said


def test_missing_package_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(FoxgloveError, match=r"is not installed; expected it from: pip install foxglove-sdk$"):
        FoxgloveServer(None, "fjr_controller", {}, 0)


def test_port_in_use_is_one_sentence() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(FoxgloveError, match=rf"port {taken.getsockname()[1]} cannot be used .*expected a free one"):
            FoxgloveServer(None, "fjr_controller", {}, taken.getsockname()[1])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--foxglove", "--once"], "--foxglove shows the loop until Ctrl-C; expected it without --once"),
        (["--foxglove", "--json"], "--foxglove shows the loop until Ctrl-C; expected it without --json"),
        (["--browser", "--once"], "--browser shows the loop until Ctrl-C; expected it without --once"),
        (["--foxglove", "--browser"], "--browser shows the loop until Ctrl-C; expected it without --foxglove"),
        (["--port", "9000"], "--port is given without --browser or --foxglove"),
        (["--foxglove", "--port", "70000"], "expected 0 to 65535"),
    ],
)
def test_options_that_do_not_fit_are_refused(arguments: list[str], words: str) -> None:
    assert words in fjr_here("watch", *arguments, code=2)
