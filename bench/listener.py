# SPDX-License-Identifier: Apache-2.0
"""Subscribe to a topic between plant and controller."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from fjr_msgs_py import names


class Listener:
    """Context manager: a node that waits for messages of one topic."""

    def __init__(self, topic: str, kind: Any) -> None:
        self.topic = topic
        self._received = False
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("fjr_bench", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(kind, topic, self._on_message, names.LATEST)

    def wait(self, longest: float) -> None:
        """Wait for a message; raise TimeoutError after `longest` [s]."""
        end = perf_counter() + longest
        while not self._received:
            if perf_counter() > end:
                raise TimeoutError(f"{self.topic} was silent for {longest:g} s; expected a message")
            self._executor.spin_once(timeout_sec=0.1)

    def _on_message(self, _: Any) -> None:
        self._received = True

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
