# SPDX-License-Identifier: Apache-2.0
"""Clients of running nodes: any service, trajectories. Every wait has a time limit.

A participant announces its endpoints in the order of their creation. A node that responds to a client has therefore
discovered everything that this process made before that client. A response is lost if the server has not yet discovered
the client; a request that may be repeated is then sent again.
"""

from __future__ import annotations

import difflib
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory

from fjr_core.errors import FjrError
from fjr_monitor.recording.message_types import interface_class
from fjr_monitor.recording.topics import nodes_seen

POLL = 0.05  # s
RETRY_AFTER = 2.0  # s without a response
RESPONSE_LIMIT = 30.0  # s; of the nodes of a run and of a controller that takes a trajectory
ACCEPTED, REFUSED = "references changed", ("trajectory refused", "trajectories given up")
"""Kinds of the events that report the outcome of a trajectory."""


class ClientError(FjrError):
    """A node is not there, does not respond or refuses."""


class ServiceClient:
    """Find services in the ROS graph and call them; every wait ends after `timeout` [s] with a ClientError."""

    def __init__(self, node: Node, timeout: float, stop: threading.Event | None = None) -> None:
        """stop: ends every wait, too."""
        self._node, self._timeout, self._stop = node, timeout, stop or threading.Event()
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)

    def close(self) -> None:
        """Release the executor."""
        self._executor.shutdown()

    def find(self, service: str) -> Client:
        """Return a client of a service given by its full name, of the type that its server has; raise ClientError."""
        after = f"after {self._timeout:g} s"
        if not self._until(lambda: service in self._services(), self._timeout):
            close = difflib.get_close_matches(service, self._services(), n=1)
            hint = f"; did you mean {close[0]}?" if close else "; expected a running node"
            raise ClientError(f"no node offers the service {service} {after}{hint} ({nodes_seen(self._node)})")
        client = self._node.create_client(interface_class(self._services()[service]), service)
        if not self._until(client.service_is_ready, self._timeout):
            raise ClientError(f"{service} is not ready {after}")
        return client

    def ask(self, client: Client, request: Any) -> Any:
        """Send a request that may be repeated, again if its response is lost; return the response."""
        end = time.monotonic() + self._timeout
        while time.monotonic() < end and not self._stop.is_set():
            response = self._response(client, request, min(RETRY_AFTER, self._timeout))
            if response is not None:
                return response
        raise ClientError(self._silent(client))

    def call(self, client: Client, request: Any) -> Any:
        """Send a request once, when the server has discovered the client; return the response.

        A node without parameter services is not asked whether it has.
        """
        offered = self._node.get_service_names_and_types_by_node
        for name, space in self._node.get_node_names_and_namespaces():
            parameters = f"{space.rstrip('/')}/{name}/get_parameters"
            with suppress(NodeNameNonExistentError):  # it has just left
                if client.srv_name in dict(offered(name, space)) and parameters in self._services():
                    self.ask(self.find(parameters), GetParameters.Request())
                    break
        response = self._response(client, request, self._timeout)
        if response is None:
            raise ClientError(f"{self._silent(client)}; whether the request was carried out is not known")
        return response

    def discovered_by(self, node: str) -> bool:
        """Return whether a node has discovered all subscriptions made in this context so far; waits RETRY_AFTER.

        A subscription that is matched here may still be unknown there.
        """
        client = self._node.create_client(GetParameters, f"/{node}/get_parameters")
        try:
            there = client.wait_for_service(RETRY_AFTER)
            return there and self._response(client, GetParameters.Request(), RETRY_AFTER) is not None
        finally:
            self._node.destroy_client(client)

    def _response(self, client: Client, request: Any, limit: float) -> Any | None:
        """Send a request once; return the response, None if there is none within `limit` [s]."""
        future = client.call_async(request)
        if self._until(future.done, limit):
            return future.result()
        client.remove_pending_request(future)
        return None

    def _until(self, happened: Callable[[], bool], limit: float) -> bool:
        """Spin until `happened()`; return false after `limit` [s] or if stopped."""
        end = time.monotonic() + limit
        while not happened():
            if time.monotonic() > end or self._stop.is_set():
                return False
            self._executor.spin_once(POLL)
        return True

    def _services(self) -> dict[str, str]:
        return {name: types[0] for name, types in self._node.get_service_names_and_types()}

    def _silent(self, client: Client) -> str:
        return f"{client.srv_name} did not respond within {self._timeout:g} s"


class TrajectoryClient(ServiceClient):
    """Send trajectories to the controller of a name such as /fjr_controller.

    Raises ClientError if the controller does not respond.
    """

    def __init__(self, node: Node, controller: str, stop: threading.Event) -> None:
        super().__init__(node, RESPONSE_LIMIT, stop)
        self._controller = controller
        self._events: list[DiagnosticStatus] = []
        node.create_subscription(DiagnosticStatus, f"{controller}/events", self._events.append, QoSProfile(depth=100))
        self._publisher = node.create_publisher(JointTrajectory, f"{controller}/joint_trajectory", 10)
        # The client is created last: a controller that responds has discovered publisher and subscription.
        client = node.create_client(GetParameters, f"{controller}/get_parameters")
        self._await(client.service_is_ready, "is not running, or its parameters are not available")
        found = self.ask(client, GetParameters.Request(names=["joints"]))
        self.joints = tuple(found.values[0].string_array_value)

    def send(self, message: JointTrajectory) -> None:
        """Publish a trajectory and wait for its outcome, an event; raise ClientError unless it is accepted."""
        self._await(lambda: self._publisher.get_subscription_count() > 0, "does not subscribe to trajectories")
        self._events.clear()
        self._publisher.publish(message)
        self._await(lambda: bool(self._outcomes()), "does not report the outcome")
        event = self._outcomes()[0]
        if event.name != ACCEPTED:
            raise ClientError(event.message)

    def _outcomes(self) -> list[DiagnosticStatus]:
        return [event for event in self._events if event.name == ACCEPTED or event.name.startswith(REFUSED)]

    def _await(self, happened: Callable[[], bool], fault: str) -> None:
        """Spin until `happened()`; raise ClientError after the time limit or if stopped."""
        if not self._until(happened, self._timeout):
            raise ClientError(f"{self._controller} {fault}; expected an active controller")
