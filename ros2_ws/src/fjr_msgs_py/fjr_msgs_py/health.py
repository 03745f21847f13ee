# SPDX-License-Identifier: Apache-2.0
"""What a node counts, says once, and reports on /diagnostics."""

from __future__ import annotations

from collections import Counter

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from .messages import MessageError
from .names import DIAGNOSTICS

PERIOD = 1.0  # s


class Health:
    """Counters of a node; published once a second, and whenever `publish` is called.

    expected: counters that are part of a healthy run; any other that is not zero makes the status WARN.
    """

    def __init__(self, node: Node, expected: tuple[str, ...]) -> None:
        self.count: Counter[str] = Counter(dict.fromkeys(expected, 0))
        self._node = node
        self._expected = set(expected)
        self._said: set[str] = set()
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(PERIOD, self.publish, clock=steady)

    def refuse(self, what: str, error: MessageError) -> None:
        """Count a refused message and say why, once for each kind of reason."""
        kind = f"{what} refused: {error.kind}"
        self.warn(kind, f"{what} refused: {error} (said once; counted on /{DIAGNOSTICS})")

    def warn(self, kind: str, sentence: str) -> None:
        """Count an unwanted event and say the sentence the first time."""
        self.count[kind] += 1
        self.say_once(kind, sentence)

    def say_once(self, kind: str, sentence: str) -> None:
        """Log the sentence as a warning, the first time that this kind comes."""
        if kind not in self._said:
            self._said.add(kind)
            self._node.get_logger().warning(sentence)

    def publish(self) -> None:
        """Publish the counters."""
        unwanted = [key for key, value in self.count.items() if value and key not in self._expected]
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if unwanted else DiagnosticStatus.OK,
            name=self._node.get_name(),
            message=", ".join(unwanted) or "ok",
            values=[KeyValue(key=key, value=str(value)) for key, value in self.count.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
