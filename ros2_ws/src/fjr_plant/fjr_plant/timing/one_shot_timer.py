# SPDX-License-Identifier: Apache-2.0
"""Timer that fires once each time it is set."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.node import Node


class OneShotTimer:
    """Timer that calls back once after it was last set."""

    def __init__(self, node: Node, clock: Clock, callback: Callable[[], None]) -> None:
        self._callback = callback
        self._timer = node.create_timer(1.0, self._fire, clock=clock)
        self._timer.cancel()

    def set(self, wait: int) -> None:
        """Fire after `wait` [ns]."""
        self._timer.timer_period_ns = max(wait, 1)
        self._timer.reset()

    def _fire(self) -> None:
        self._timer.cancel()
        self._callback()
