# SPDX-License-Identifier: Apache-2.0
"""Hosts of C functions that answer messages: a native thread, or callbacks of rclpy's executor."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher

from .. import names
from .loop import NativeLoop, NativeSubscription, publisher_address
from .program import Program

NO_TIME = 2**63 - 1
"""FJR_NO_TIME."""


class NativeHost(NativeLoop):
    """A thread in C that serves the messages of a topic."""

    def __init__(self, node: Node, program: Program, prefix: str, state: Any, kind: type, topic: str) -> None:
        """Subscribe and create the thread; raises NativeError.

        prefix: of the functions of struct fjr_host, as in PREFIX_on_tick. state: a structure that they get, with the
        fields `loop` and `publisher`.
        """
        functions = (program.ffi.addressof(program.lib, f"{prefix}_on_{what}") for what in CALLED)
        self.state, self.subscription = state, NativeSubscription(node, kind, topic, names.LATEST)
        super().__init__(program, program.ffi.new("struct fjr_host*", (state, *functions)), [self.subscription])
        state.loop = self.pointer

    def use(self, publishers: Sequence[Publisher]) -> None:
        """Let the C send by these publishers, in the order of its outputs; not while the thread runs."""
        super().use(publishers)
        for k, publisher in enumerate(publishers):
            self.state.publisher[k] = publisher_address(self._program, publisher)

    def close(self) -> None:
        """End the thread and destroy the subscription, which the node does not know; the caller serves requests."""
        self.stop()
        self.subscription.close()


CALLED = ("message", "tick", "request", "end")


class RclpyHost(ABC):
    """Callbacks of the node's executor. publish: callback for the C that sends a message; reason: why it failed."""

    def __init__(self, node: Node, program: Program, kind: type, topic: str, clock: Clock | None = None) -> None:
        """Subscribe. clock: of the ticks; None: the steady one."""
        self._node, self._program, self._clock = node, program, clock
        self._publishers: Sequence[Publisher] = ()
        self.reason: BaseException | str = ""
        self.publish = program.ffi.callback(
            "int(void*, int32_t, const struct fjr_message*)", self._publish, error=program.lib.FJR_FAILED
        )
        self._subscription = node.create_subscription(kind, topic, self._serve_message, names.LATEST, raw=True)
        self._timer = self._ticking(1.0)
        self._timer.cancel()
        self._due, self._next = NO_TIME, program.ffi.new("int64_t*")

    @abstractmethod
    def _serve_message(self, message: bytes) -> None:
        """Let the C handle a serialised message."""

    @abstractmethod
    def _serve_tick(self) -> None:
        """Let the C handle a tick."""

    def use(self, publishers: Sequence[Publisher]) -> None:
        """Let the C send by these publishers, in the order of its outputs."""
        self._publishers = publishers

    def now(self) -> int:
        """Return the time of the clock of the ticks [ns]."""
        return time.monotonic_ns() if self._clock is None else int(self._clock.now().nanoseconds)

    def close(self) -> None:
        """Destroy subscription and timer; a second call does nothing."""
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_timer(self._timer)

    def _ticking(self, period: float) -> Any:
        """Return a timer of the ticks; period [s]."""
        return self._node.create_timer(period, self._tick, clock=self._clock or Clock(clock_type=ClockType.STEADY_TIME))

    def _tick(self) -> None:
        self._timer.cancel()
        self._due = NO_TIME
        self._serve_tick()

    def _tick_by(self, due: int) -> None:
        """Let the next tick come at a time [ns], unless it comes earlier anyway."""
        if due < self._due:
            self._due = due
            self._timer.timer_period_ns = max(due - self.now(), 1)
            self._timer.reset()

    def _publish(self, _: Any, output: int, message: Any) -> int:
        try:
            self._publishers[output].publish(bytes(self._program.ffi.buffer(message.bytes, message.size)))
        except Exception as error:
            self.reason = error
            return int(self._program.lib.FJR_FAILED)
        return 0
