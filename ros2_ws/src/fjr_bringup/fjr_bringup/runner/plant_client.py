# SPDX-License-Identifier: Apache-2.0
"""The plant's pause service and the graph as a small node sees them."""

from __future__ import annotations

import time

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import SetBool

from fjr_core.errors import FjrError

ANSWER_LIMIT = 30.0  # s
ASK_AGAIN = 2.0  # s without an answer, which is lost where the plant has not found this client yet


class RemoteError(FjrError):
    """A service that does not answer or refuses."""


class PlantRemote:
    """Lets a paused plant go."""

    def __init__(self, context: Context, plant: str) -> None:
        self._node = rclpy.create_node("fjr_run", context=context, enable_rosout=False, start_parameter_services=False)
        self._service = f"/{plant}/pause"
        self._client = self._node.create_client(SetBool, self._service)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)

    def published_by(self, node: str) -> list[str]:
        """Topics that a node publishes, empty while it is not in the graph."""
        found = [name for name in self._node.get_node_names() if name == node]
        return [topic for topic, _ in self._node.get_publisher_names_and_types_by_node(node, "/")] if found else []

    def ready(self) -> bool:
        """Whether the plant's service is connected."""
        return self._client.service_is_ready()

    def resume(self) -> None:
        """Call the service until it answers; raises RemoteError when it refuses or stays silent."""
        latest, answer = time.monotonic() + ANSWER_LIMIT, None
        while answer is None and time.monotonic() < latest:
            future = self._client.call_async(SetBool.Request(data=False))
            self._executor.spin_until_future_complete(future, ASK_AGAIN)
            answer = future.result() if future.done() else None
        if answer is None or not answer.success:
            why = "no answer" if answer is None else answer.message
            raise RemoteError(f"{self._service} did not let the plant go: {why}")

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
