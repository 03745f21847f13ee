# SPDX-License-Identifier: Apache-2.0
"""Hosts of C functions that answer messages, a thread or rclpy's executor, and the structures of such functions."""

from __future__ import annotations

import atexit
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.type_support import check_is_valid_msg_type

from fjr_core.numerics.jit import record_type

from ..messages.cdr import HEADER, Form
from ..names import LATEST, STEADY
from .program import NativeError, Program

NAMES_ROOM = 1 << 13  # bytes of a list of names that is compared instead of looked up


class NativeSubscription:
    """A subscription of a node that no executor serves, so that a native loop alone takes its messages.

    Incompatible publishers are logged by the executor of the node, as for any other subscription.
    """

    def __init__(self, node: Node, kind: type, topic: str, qos: QoSProfile) -> None:
        self._node, self._kind, group = node, kind, node.default_callback_group
        check_is_valid_msg_type(kind)  # loads the code of the type
        with node.handle:
            self.handle = rclpy_implementation.Subscription(node.handle, kind, topic, qos.get_c_qos_profile())
        events = SubscriptionEventCallbacks()
        self._subscription = Subscription(self.handle, kind, topic, lambda _: None, group, qos, True, events)
        for handler in self._subscription.event_handlers:
            node.add_waitable(handler)
        self.address, self._open = int(self.handle.pointer), True

    @property
    def publishers(self) -> int:
        """Number of connected publishers."""
        return int(self._subscription.get_publisher_count())

    def take(self) -> tuple[Any, dict[str, Any]] | None:
        """Take the oldest waiting message: return it and its info, or None. No native loop may serve it."""
        with self.handle:
            return self.handle.take_message(self._kind, False)

    def close(self) -> None:
        """Destroy the subscription; a second call does nothing."""
        if self._open:
            self._open = False
            for handler in self._subscription.event_handlers:
                self._node.remove_waitable(handler)
            self._subscription.destroy()


class NativeMessage:
    """A serialised message as struct fjr_message; `pointer` is valid as long as the object lives."""

    def __init__(self, program: Program, form: Form) -> None:
        ffi = program.ffi
        self._buffer = bytearray(HEADER) + form.empty
        self._view = ffi.from_buffer(self._buffer)
        offsets = [8 * start - HEADER for start in form.starts]
        self.pointer = ffi.new(
            "struct fjr_message*",
            {
                "bytes": ffi.cast("uint8_t*", self._view) + HEADER,
                "size": len(self._buffer) - HEADER,
                "at": offsets,
                "length": form.lengths,
            },
        )

    def serialised(self) -> bytes:
        """Return a copy of the message."""
        return bytes(self._buffer[HEADER:])


class NativeReader:
    """A reader of JointStates as struct fjr_joint_reader; `pointer` is valid as long as the object lives.

    values: by field (position, velocity, effort), the numbers (k,) of the names in their order; None if not wanted.
    """

    def __init__(self, program: Program, names: Sequence[str], wanted: int) -> None:
        """names: those that are wanted; wanted: sum of enum fjr_field."""
        ffi, k = program.ffi, len(names)
        texts = [ffi.new("char[]", name.encode()) for name in names]
        self.values = [np.zeros(k) if wanted >> field & 1 else None for field in range(3)]
        views = [ffi.NULL if value is None else ffi.from_buffer("double[]", value) for value in self.values]
        table, columns, seen = ffi.new("char*[]", texts), ffi.new("int32_t[]", k), ffi.new("uint8_t[]", NAMES_ROOM)
        self._kept = (texts, views, table, columns, seen)
        self.pointer = ffi.new(
            "struct fjr_joint_reader*",
            {
                "joints": k,
                "wanted": wanted,
                "name": ffi.cast("char**", table),
                "column": columns,
                "seen": seen,
                "room": NAMES_ROOM,
                "value": views,
            },
        )


class Ring:
    """A queue of records from a native loop to Python; `pointer` is a struct fjr_ring*."""

    def __init__(self, program: Program, kind: str, capacity: int) -> None:
        """kind: type of a record in C; capacity: a power of 2. All slots are in RAM: the loop meets no page fault."""
        ffi = program.ffi
        self._program, self._type = program, record_type(ffi, ffi.typeof(kind))
        self._slots, self._taken = np.full(capacity, 0, self._type), np.zeros(capacity, self._type)  # full: in RAM
        self._views = [ffi.from_buffer("uint8_t[]", each.view(np.uint8)) for each in (self._slots, self._taken)]
        given = {"slots": self._views[0], "capacity": capacity, "record": self._type.itemsize}
        self.pointer = ffi.new("struct fjr_ring*", given)

    def take(self, most: int | None = None) -> NDArray[Any]:
        """Return the waiting records, the oldest first, valid until the next call; most: at most so many."""
        most = len(self._taken) if most is None else min(most, len(self._taken))
        return self._taken[: self._program.lib.fjr_ring_take(self.pointer, self._views[1], most)]

    @property
    def lost(self) -> int:
        """Number of records that found no place so far."""
        return int(self._program.lib.fjr_ring_lost(self.pointer))


LARGEST = 1 << 16  # bytes of a message that is taken without allocation
_running: set[NativeLoop] = set()


class NativeLoop:
    """A thread in C that serves subscriptions; `pointer` is its struct fjr_loop*."""

    def __init__(
        self, program: Program, callbacks: Mapping[str, Any], subscriptions: Sequence[NativeSubscription]
    ) -> None:
        """Create the loop; callbacks: fields of struct fjr_callbacks. Raises NativeError."""
        self._program, self._callbacks, self.subscriptions = program, callbacks, tuple(subscriptions)
        self._held, self._publishers = ExitStack(), ()
        addresses = [program.ffi.cast("void*", each.address) for each in subscriptions]
        given = program.ffi.new("struct fjr_callbacks*", callbacks)
        made = program.lib.fjr_loop_create(given, addresses, len(addresses), LARGEST)
        if not made:
            raise NativeError("the loop cannot be created (out of memory)")
        self.pointer = program.ffi.gc(made, program.lib.fjr_loop_destroy)

    def use(self, publishers: Sequence[Publisher]) -> None:
        """Let the C send by these publishers, in the order of its outputs; not while the thread runs."""
        self._publishers = tuple(publishers)
        addresses = [self._program.ffi.cast("void*", each.handle.pointer) for each in publishers]
        self._addresses = self._program.ffi.new("void*[]", addresses)
        self._program.lib.fjr_loop_use(self.pointer, self._addresses)

    def start(self, priority: int = 0) -> None:
        """Start the thread, at this SCHED_FIFO priority if the system allows it; raises NativeError."""
        for entity in (*self.subscriptions, *self._publishers):
            self._held.enter_context(entity.handle)
        error = self._program.lib.fjr_loop_start(self.pointer, priority)
        if error:
            self._held.close()
            raise NativeError(f"the thread of the loop cannot be started ({os.strerror(error)})")
        _running.add(self)

    def stop(self) -> None:
        """End the thread and wait for it; without a thread do nothing."""
        self._program.lib.fjr_loop_stop(self.pointer)
        self._held.close()
        _running.discard(self)

    def close(self) -> None:
        """End the thread and destroy the subscriptions, which the node does not know; the caller serves requests."""
        self.stop()
        for subscription in self.subscriptions:
            subscription.close()

    def request(self, kind: int, argument: Any = None) -> int:
        """Let the thread call on_request between two messages; return the result."""
        ffi = self._program.ffi
        return int(self._program.lib.fjr_loop_request(self.pointer, kind, ffi.NULL if argument is None else argument))

    def hold(self, hold: bool) -> None:
        """Let messages wait from the end of the next request on, or take them again."""
        self._program.lib.fjr_loop_hold(self.pointer, hold)

    @property
    def runs(self) -> bool:
        """True while the thread runs."""
        return bool(self._program.lib.fjr_loop_runs(self.pointer))

    @property
    def reason(self) -> str:
        """Why the middleware has failed; empty if it has not."""
        return self._program.ffi.string(self._program.lib.fjr_loop_reason(self.pointer)).decode(errors="replace")


@atexit.register
def _end_all() -> None:
    """End threads that nobody has ended; they must not call a Python that is shut down."""
    for loop in tuple(_running):
        loop.stop()


NO_TIME = 2**63 - 1
"""FJR_NO_TIME."""


class RclpyHost(ABC):
    """Callbacks of the node's executor, which call the same functions in C as the thread of a NativeLoop.

    publish: callback for the C that sends a message; reason: why it failed.
    """

    def __init__(
        self,
        node: Node,
        program: Program,
        callbacks: Mapping[str, Any],
        kind: type,
        topic: str,
        clock: Clock | None = None,
    ) -> None:
        """Subscribe. callbacks: fields of struct fjr_callbacks. clock: of the ticks; None: the steady one."""
        self._node, self._program, self._callbacks, self._clock = node, program, callbacks, clock
        self._publishers: Sequence[Publisher] = ()
        self.reason: BaseException | str = ""
        self.publish = program.ffi.callback(
            "int(void*, int32_t, const struct fjr_message*)", self._publish, error=program.lib.FJR_FAILED
        )
        self._subscription = node.create_subscription(kind, topic, self._serve_message, LATEST, raw=True)
        self._timer = self._ticking(1.0)
        self._timer.cancel()
        self._due, self._next = NO_TIME, program.ffi.new("int64_t*")

    @abstractmethod
    def _goes_on(self, outcome: int) -> bool:
        """Return False, and end, after the outcome of a failure."""

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
        return self._node.create_timer(period, self._tick, clock=self._clock or STEADY)

    def _tick(self) -> None:
        self._timer.cancel()
        self._due = NO_TIME
        if self._goes_on(self._callbacks["on_tick"](self._callbacks["self"], self.now(), self._next)):
            self._tick_by(int(self._next[0]))

    def _serve_message(self, message: bytes) -> None:
        data, self._next[0] = self._program.ffi.from_buffer("uint8_t[]", message), NO_TIME
        given = self._callbacks["self"], 0, data, len(message), self.now(), self._next
        if self._goes_on(self._callbacks["on_message"](*given)):
            self._tick_by(int(self._next[0]))

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
