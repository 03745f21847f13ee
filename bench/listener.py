# SPDX-License-Identifier: Apache-2.0
"""Hears one of the topics between plant and controller."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from fjr_msgs_py import names


class Listener:
    """A node that waits for messages of one topic, and costs nothing when it is closed; a context manager."""

    def __init__(self, topic: str, kind: Any) -> None:
        self.topic = topic
        self._heard = False
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("fjr_bench", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(kind, topic, self._hear, names.LATEST)

    def wait(self, longest: float) -> None:
        """Return when a message came; TimeoutError after so many seconds."""
        end = perf_counter() + longest
        while not self._heard:
            if perf_counter() > end:
                raise TimeoutError(f"{self.topic} was silent for {longest:g} s; expected a message")
            self._executor.spin_once(timeout_sec=0.1)

    def _hear(self, _: Any) -> None:
        self._heard = True

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
