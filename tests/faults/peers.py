# SPDX-License-Identifier: Apache-2.0
"""Nodes beside the pair under test: a watcher of every topic, a relay that modifies states, a user who acts on it."""

from __future__ import annotations

import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from fjr_core.config.nodes import PLANT
from fjr_msgs_py.names import LATEST
from fjr_msgs_py.node.participant import leave
from nodes.harness import EventsExecutor, Listener, Ros

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


APART = 3e-4  # s between replacement messages: the queue of a slow reader keeps only the newest
Tamper = Callable[[JointState], Iterable[JointState]]
"""Return the messages that replace a message."""


class Relay:
    """Forward JointStates from one topic to another in a separate thread."""

    def __init__(self, source: str, target: str) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("relay", context=self._context, enable_rosout=False)
        self._publisher = self._node.create_publisher(JointState, target, LATEST)
        self._tampering: tuple[int, int, Tamper] | None = None
        self._node.create_subscription(JointState, source, self._pass_on, LATEST, raw=True)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._stop: Future = Future()
        self._thread = threading.Thread(target=self._spin, name="relay", daemon=True)
        self._thread.start()

    def tamper(self, begin: int, end: int, how: Tamper) -> None:
        """Send `how(message)` in place of each message stamped from `begin` to before `end` [ns]."""
        self._tampering = (begin, end, how)

    def connected(self) -> bool:
        """Return whether the forwarded topic has its subscribers."""
        return bool(self._publisher.get_subscription_count() >= 2)  # the watcher and the controller

    def close(self) -> None:
        self._executor.create_task(lambda: self._stop.set_result(None))
        self._thread.join()
        self._executor.remove_node(self._node)
        self._executor.shutdown()  # otherwise the publisher stays in the graph until garbage collection
        leave(self._node)
        self._context.try_shutdown()

    def _spin(self) -> None:
        while not self._stop.done():
            self._executor.spin_until_future_complete(self._stop, 0.25)

    def _pass_on(self, raw: bytes) -> None:
        begin, end, how = self._tampering or (0, 0, iter)
        if begin <= stamp_of(raw) < end:
            for count, message in enumerate(how(deserialize_message(raw, JointState))):
                if count:
                    time.sleep(APART)
                self._publisher.publish(message)
        else:
            self._publisher.publish(raw)


class Remote:
    """Act like a user: set parameters, advance the plant, publish conflicting efforts."""

    def __init__(self) -> None:
        self._ros = Ros()
        self._node = Listener(self._ros, only=())
        self.requests: list[tuple[str, int, Mapping[str, Any]]] = []  # node, time [ns], parameters

    def set(self, node: str, values: Mapping[str, Any]) -> str:
        """Set parameters of a node together; return the reason of a refusal, or ""."""
        self.requests.append((node, time.time_ns(), values))
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        service = f"{node}/set_parameters_atomically"
        result = self._node.call(SetParametersAtomically, service, parameters=parameters).result
        return "" if result.successful else str(result.reason)

    def get(self, node: str, name: str) -> Any:
        """Return a parameter of a node."""
        (value,) = self._node.call(GetParameters, f"{node}/get_parameters", names=[name]).values
        return parameter_value_to_python(value)

    def advance(self, samples: int) -> Future:
        """Advance a paused plant by a number of samples; the response arrives when they are done."""
        assert self.set(PLANT, {"advance_samples": samples}) == ""
        return self._node.request(Trigger, f"{PLANT}/advance")

    def intrude(self, period: float, joints: int) -> None:
        """Start to publish zero efforts every `period` seconds while `work` is called."""
        publisher = self._node.create_publisher(Float64MultiArray, EFFORTS, LATEST)
        zero = Float64MultiArray(data=[0.0] * joints)
        self._intruder = (self._node.create_timer(period, lambda: publisher.publish(zero)), publisher)

    def retreat(self) -> None:
        """Stop publishing efforts."""
        timer, publisher = self._intruder
        self._node.destroy_timer(timer)
        self._node.destroy_publisher(publisher)

    def work(self) -> None:
        """Process pending events."""
        self._ros.executor.spin_once(timeout_sec=0.0)

    def close(self) -> None:
        self._ros.close()
