# SPDX-License-Identifier: Apache-2.0
"""Client of the plant's pause service, with its view of the ROS graph."""

from __future__ import annotations

import time
from contextlib import suppress

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import NodeNameNonExistentError
from std_srvs.srv import SetBool

from fjr_core.errors import FjrError

RESPONSE_LIMIT = 30.0  # s
RETRY_AFTER = 2.0  # s without a response; it is lost if the plant has not discovered this client yet


class PlantClientError(FjrError):
    """The service does not respond or refuses."""


class PlantClient:
    """Resume a paused plant."""

    def __init__(self, context: Context, plant: str) -> None:
        self._node = rclpy.create_node("fjr_run", context=context, enable_rosout=False, start_parameter_services=False)
        self._service = f"/{plant}/pause"
        self._client = self._node.create_client(SetBool, self._service)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)

    def published_by(self, node: str) -> list[str]:
        """Return the topics that a node without a namespace publishes; none while it is not in the graph."""
        with suppress(NodeNameNonExistentError):
            return [topic for topic, _ in self._node.get_publisher_names_and_types_by_node(node, "/")]
        return []

    def ready(self) -> bool:
        """Return whether the plant's service is available."""
        return self._client.service_is_ready()

    def discovered_by(self, node: str) -> bool:
        """Return whether a node has discovered all subscriptions made in this context so far; waits RETRY_AFTER.

        A participant announces its endpoints in the order of their creation. A node that responds to a client made now
        has therefore discovered what was made before. A subscription that is matched here may still be unknown there.
        """
        client = self._node.create_client(GetParameters, f"/{node}/get_parameters")
        try:
            if not client.wait_for_service(RETRY_AFTER):
                return False
            future = client.call_async(GetParameters.Request())
            self._executor.spin_until_future_complete(future, RETRY_AFTER)
            return bool(future.done())
        finally:
            self._node.destroy_client(client)

    def resume(self) -> None:
        """Call the service until it responds; raises PlantClientError if it refuses or does not respond."""
        latest, answer = time.monotonic() + RESPONSE_LIMIT, None
        while answer is None and time.monotonic() < latest:
            future = self._client.call_async(SetBool.Request(data=False))
            self._executor.spin_until_future_complete(future, RETRY_AFTER)
            answer = future.result() if future.done() else None
        if answer is None or not answer.success:
            why = "no response" if answer is None else answer.message
            raise PlantClientError(f"{self._service} did not resume the plant: {why}")

    def close(self) -> None:
        """Destroy the node."""
        self._executor.shutdown()
        self._node.destroy_node()
