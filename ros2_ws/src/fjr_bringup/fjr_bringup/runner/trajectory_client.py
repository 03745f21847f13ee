# SPDX-License-Identifier: Apache-2.0
"""Client of a running controller: its joints, and trajectories with the outcome that it reports on ~/events."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory

from fjr_core.errors import FjrError
from fjr_msgs_py.node.participant import own_node

RESPONSE_LIMIT = 30.0  # s
RETRY_AFTER = 2.0  # s without a response; it is lost if the controller has not discovered this client yet
ACCEPTED, REFUSED = "references changed", ("trajectory refused", "trajectories given up")
"""Kinds of the events that report the outcome of a trajectory."""


class TrajectoryClientError(FjrError):
    """The controller does not respond, or refuses the trajectory."""


class TrajectoryClient:
    """Send trajectories to the controller of a name such as /fjr_controller; create it with `connected`."""

    def __init__(self, node: Node, controller: str, stop: threading.Event) -> None:
        self._node, self._controller, self._stop = node, controller, stop
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._events: list[DiagnosticStatus] = []
        node.create_subscription(DiagnosticStatus, f"{controller}/events", self._events.append, QoSProfile(depth=100))
        self._publisher = node.create_publisher(JointTrajectory, f"{controller}/joint_trajectory", 10)
        self.joints = self._joints()

    def send(self, message: JointTrajectory) -> None:
        """Publish a trajectory and wait for its outcome; raise TrajectoryClientError unless it is accepted."""
        self._until(lambda: self._publisher.get_subscription_count() > 0, "does not subscribe to trajectories")
        self._events.clear()
        self._publisher.publish(message)
        self._until(lambda: any(self._outcome(event) for event in self._events), "does not report the outcome")
        event = next(event for event in self._events if self._outcome(event))
        if event.name != ACCEPTED:
            raise TrajectoryClientError(event.message)

    def close(self) -> None:
        """Release the executor."""
        self._executor.shutdown()

    def _joints(self) -> tuple[str, ...]:
        """Return the joints of the controller, which has discovered publisher and subscription once it responds.

        A participant announces its endpoints in the order of their creation, and the client is created last.
        """
        client = self._node.create_client(GetParameters, f"{self._controller}/get_parameters")
        self._until(client.service_is_ready, "is not running, or its parameters are not available")
        latest = time.monotonic() + RESPONSE_LIMIT
        while time.monotonic() < latest and not self._stop.is_set():
            future = client.call_async(GetParameters.Request(names=["joints"]))
            self._executor.spin_until_future_complete(future, RETRY_AFTER)
            if future.done():
                return tuple(future.result().values[0].string_array_value)
        raise TrajectoryClientError(f"{self._controller} does not respond; expected a running controller")

    @staticmethod
    def _outcome(event: DiagnosticStatus) -> bool:
        return event.name == ACCEPTED or event.name.startswith(REFUSED)

    def _until(self, happened: Callable[[], bool], fault: str) -> None:
        """Spin until `happened()`; raise TrajectoryClientError after RESPONSE_LIMIT or if stopped."""
        latest = time.monotonic() + RESPONSE_LIMIT
        while not happened():
            if time.monotonic() > latest or self._stop.is_set():
                raise TrajectoryClientError(f"{self._controller} {fault}; expected an active controller")
            self._executor.spin_once(timeout_sec=0.05)


@contextmanager
def connected(controller: str, stop: threading.Event) -> Iterator[TrajectoryClient]:
    """Create the client in a context of its own; raise TrajectoryClientError if the controller does not respond."""
    with own_node("fjr_send") as node:
        client = TrajectoryClient(node, controller, stop)
        yield client
        client.close()
