# SPDX-License-Identifier: Apache-2.0
"""Nodes beside the watched pair: a relay that forwards and modifies states, and a user who acts on running nodes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from faults.watcher import EFFORTS, stamp_of
from fjr_msgs_py.names import LATEST, PLANT
from fjr_msgs_py.node.participant import leave
from nodes.harness import EventsExecutor, Listener, Ros

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
