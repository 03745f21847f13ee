# SPDX-License-Identifier: Apache-2.0
"""Act on running nodes like a user: set parameters, advance the plant, publish conflicting efforts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import rclpy
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from faults.watcher import EFFORTS
from fjr_msgs_py.names import LATEST, PLANT
from fjr_msgs_py.node.participant import leave

LIMIT = 120.0  # s


class Remote:
    """A node in addition to the watched pair."""

    def __init__(self) -> None:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("remote", context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._advance: Client | None = None
        self._clients: dict[str, AsyncParameterClient] = {}

    def set(self, node: str, values: Mapping[str, Any]) -> str:
        """Set parameters of a node together; return the reason of a refusal, or ""."""
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        result = self._done(self._client(node).set_parameters_atomically(parameters)).result
        return "" if result.successful else str(result.reason)

    def get(self, node: str, name: str) -> Any:
        """Return a parameter of a node."""
        answer = self._done(self._client(node).get_parameters([name]))
        return rclpy.parameter.parameter_value_to_python(answer.values[0])

    def advance(self, samples: int) -> Future:
        """Advance a paused plant by a number of samples; the response arrives when they are done."""
        assert self.set(PLANT, {"advance_samples": samples}) == ""
        if self._advance is None:
            self._advance = self._node.create_client(Trigger, f"{PLANT}/advance")
            assert self._advance.wait_for_service(LIMIT), "no service to advance the plant"
        return self._advance.call_async(Trigger.Request())

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
        self._executor.spin_once(timeout_sec=0.0)

    def close(self) -> None:
        self._executor.shutdown()
        leave(self._node)
        self._context.try_shutdown()

    def _client(self, node: str) -> AsyncParameterClient:
        if node not in self._clients:
            self._clients[node] = AsyncParameterClient(self._node, node)
            assert self._clients[node].wait_for_services(LIMIT), f"no parameter services of {node}"
        return self._clients[node]

    def _done(self, future: Any) -> Any:
        self._executor.spin_until_future_complete(future, LIMIT)
        assert future.done(), f"no answer within {LIMIT} s"
        return future.result()
