# SPDX-License-Identifier: Apache-2.0
"""A relay between plant and controller that forwards messages and modifies those between two stamps."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

import rclpy
from rclpy.context import Context
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from sensor_msgs.msg import JointState

from faults.watcher import stamp_of
from fjr_msgs_py.names import LATEST
from fjr_msgs_py.node.participant import leave
from nodes.harness import EventsExecutor

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
