# SPDX-License-Identifier: Apache-2.0
"""Call the services of running nodes, each wait with a time limit."""

from __future__ import annotations

import difflib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from fjr_core.errors import FjrError
from fjr_monitor.recording.topic import interface_class
from fjr_monitor.recording.topics import nodes_seen
from fjr_msgs_py.node.participant import own_node

POLL = 0.05  # s
RETRY_AFTER = 2.0  # s without a response; it is lost if the server has not discovered this client yet


class ServiceError(FjrError):
    """A service is not there, does not respond or refuses."""


class ServiceClient:
    """Find services in the ROS graph and call them; every wait ends after `timeout` [s] with a ServiceError."""

    def __init__(self, node: Node, timeout: float) -> None:
        self._node, self._timeout = node, timeout
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)

    def find(self, service: str) -> Client:
        """Return a client of a service given by its full name, of the type that its server has; raise ServiceError."""
        self._wait(lambda: service in self._services(), lambda: self._missing(service))
        client = self._node.create_client(interface_class(self._services()[service]), service)
        self._wait(client.service_is_ready, lambda: f"{service} is not ready after {self._timeout:g} s")
        return client

    def ask(self, client: Client, request: Any) -> Any:
        """Send a request that changes nothing, again if its response is lost; return the response."""
        end = time.monotonic() + self._timeout
        while time.monotonic() < end:
            response = self._response(client, request, min(RETRY_AFTER, self._timeout))
            if response is not None:
                return response
        raise ServiceError(self._silent(client))

    def call(self, client: Client, request: Any) -> Any:
        """Send a request once, when the server has discovered the client; return the response."""
        self._await_discovery(client.srv_name)
        response = self._response(client, request, self._timeout)
        if response is None:
            raise ServiceError(f"{self._silent(client)}; whether the request was carried out is not known")
        return response

    def close(self) -> None:
        """Release the executor."""
        self._executor.shutdown()

    def _response(self, client: Client, request: Any, seconds: float) -> Any | None:
        future, end = client.call_async(request), time.monotonic() + seconds
        while not future.done() and time.monotonic() < end:
            self._executor.spin_once(POLL)
        if not future.done():
            client.remove_pending_request(future)
            return None
        return future.result()

    def _await_discovery(self, service: str) -> None:
        """Wait until the server's node has discovered all clients made so far.

        A participant announces its endpoints in the order of their creation: a node that responds to a client made now
        has discovered the earlier ones. A node without parameter services is not asked.
        """
        parameters = f"{self._owner(service)}/get_parameters"
        if parameters in self._services():
            self.ask(self.find(parameters), GetParameters.Request())

    def _owner(self, service: str) -> str:
        """Return the full name of the node that offers a service; empty if the graph does not show it."""
        for name, space in self._node.get_node_names_and_namespaces():
            if service in dict(self._node.get_service_names_and_types_by_node(name, space)):
                return f"{space.rstrip('/')}/{name}"
        return ""

    def _services(self) -> dict[str, str]:
        return {name: types[0] for name, types in self._node.get_service_names_and_types()}

    def _wait(self, condition: Callable[[], bool], failure: Callable[[], str]) -> None:
        end = time.monotonic() + self._timeout
        while not condition():
            if time.monotonic() > end:
                raise ServiceError(failure())
            time.sleep(POLL)

    def _missing(self, service: str) -> str:
        close = difflib.get_close_matches(service, self._services(), n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        return (
            f"no node offers the service {service} after {self._timeout:g} s{hint or '; expected a running node'} "
            f"({nodes_seen(self._node)})"
        )

    def _silent(self, client: Client) -> str:
        return f"{client.srv_name} did not respond within {self._timeout:g} s"


@contextmanager
def service_client(timeout: float) -> Iterator[ServiceClient]:
    """Yield a client of services, with a node in its own context."""
    with own_node("fjr_client") as node:
        client = ServiceClient(node, timeout)
        try:
            yield client
        finally:
            client.close()
