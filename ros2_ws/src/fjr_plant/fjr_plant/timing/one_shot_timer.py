# SPDX-License-Identifier: Apache-2.0
"""A timer that rings once each time that it is set."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.node import Node


class Alarm:
    """Calls back once, a while after it was last set."""

    def __init__(self, node: Node, clock: Clock, callback: Callable[[], None]) -> None:
        self._callback = callback
        self._timer = node.create_timer(1.0, self._ring, clock=clock)
        self._timer.cancel()

    def set(self, wait: int) -> None:
        """Ring after `wait` [ns]."""
        self._timer.timer_period_ns = max(wait, 1)
        self._timer.reset()

    def _ring(self) -> None:
        self._timer.cancel()
        self._callback()
