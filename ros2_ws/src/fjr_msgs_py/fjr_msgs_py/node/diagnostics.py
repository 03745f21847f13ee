# SPDX-License-Identifier: Apache-2.0
"""What a node counts, says once, and reports on /diagnostics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ..messages.joint_states import MessageError
from ..names import DIAGNOSTICS, full_name

PERIOD = 1.0  # s
_PERIOD_NS = round(PERIOD * 1e9)


class Health:
    """Counters of a node; published once a second, and whenever `publish` is called.

    expected: counters that are part of a healthy run; any other that is not zero makes the status WARN, one
    counted by `error` makes it ERROR. With use_sim_time a second is one of the stamps given to `at`, so that
    reports repeat with the run.
    """

    def __init__(self, node: Node, expected: tuple[str, ...], robot: str = "") -> None:
        """robot: its name, which with the node's namespace is the hardware_id of every status."""
        self.count: Counter[str] = Counter(dict.fromkeys(expected, 0))
        self._node = node
        self._hardware = f"{node.get_namespace()}/{robot}".strip("/")
        self._expected = set(expected)
        self._errors: set[str] = set()
        self._values: dict[str, str] = {}
        self._others: list[Callable[[], DiagnosticStatus]] = []
        self._said: set[str] = set()
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self._by_stamps = bool(node.get_parameter("use_sim_time").value)
        self._stamp = self._reported = 0
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = None if self._by_stamps else node.create_timer(PERIOD, self.publish, clock=steady)

    def refuse(self, what: str, error: MessageError) -> None:
        """Count a refused message and say why, once for each kind of reason."""
        kind = f"{what} refused: {error.kind}"
        self.warn(kind, f"{what} refused: {error} (said once; counted on {DIAGNOSTICS})")

    def warn(self, kind: str, sentence: str) -> None:
        """Count an unwanted event and log the sentence as a warning, the first time that this kind comes."""
        self.count[kind] += 1
        if self.is_new(kind):
            self._node.get_logger().warning(sentence)

    def error(self, kind: str, sentence: str) -> None:
        """Count an event that makes the node's status ERROR, and log the sentence as an error, the first time."""
        self._errors.add(kind)
        self.count[kind] += 1
        if self.is_new(kind):
            self._node.get_logger().error(sentence)

    def is_new(self, kind: str) -> bool:
        """Whether this is the first time that this kind is asked for."""
        new = kind not in self._said
        self._said.add(kind)
        return new

    def value(self, key: str, text: str) -> None:
        """Report a value besides the counters, from the next report on."""
        self._values[key] = text

    def besides(self, status: Callable[[], DiagnosticStatus]) -> None:
        """Publish another status beside the counters, asked for at each report."""
        self._others.append(status)

    def at(self, stamp: int) -> None:
        """Tell the time [ns] of what has just been handled: with use_sim_time a report goes out once a second of it."""
        if self._by_stamps:
            self._stamp = stamp
            if not 0 <= stamp - self._reported < _PERIOD_NS:
                self._reported = stamp
                self.publish()

    def close(self) -> None:
        """Report no more; for a node that makes another one."""
        if self._timer:
            self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)

    def publish(self) -> None:
        """Publish the counters."""
        unwanted = [key for key, value in self.count.items() if value and key not in self._expected]
        status = DiagnosticStatus(
            level=self._level(unwanted),
            name=full_name(self._node),
            message=", ".join(unwanted) or "ok",
            values=[KeyValue(key=key, value=str(value)) for key, value in self.count.items()]
            + [KeyValue(key=key, value=text) for key, text in self._values.items()],
        )
        message = DiagnosticArray(status=[status, *(other() for other in self._others)])
        for each in message.status:
            each.hardware_id = self._hardware
        message.header.stamp = self._now()
        self._publisher.publish(message)

    def _now(self) -> Time:
        if not self._by_stamps:
            return self._node.get_clock().now().to_msg()
        sec, nanosec = divmod(self._stamp, 1_000_000_000)
        return Time(sec=sec, nanosec=nanosec)

    def _level(self, unwanted: list[str]) -> bytes:
        if self._errors & set(unwanted):
            return DiagnosticStatus.ERROR
        return DiagnosticStatus.WARN if unwanted else DiagnosticStatus.OK
