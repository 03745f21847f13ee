# SPDX-License-Identifier: Apache-2.0
"""Hosts of the command loop: a native thread, or callbacks of rclpy's executor. Both call the same C."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from fjr_msgs_py import names
from fjr_msgs_py.native.loop import NativeLoop, NativeSubscription, publisher_address
from fjr_msgs_py.native.program import Program

from .command_topics import TOPICS, CommandTopics

NO_TIME = 2**63 - 1
"""FJR_NO_TIME."""
BIG_ENDIAN = b"\x00"
"""Second byte of a serialised message (CDR) in the other byte order, which the C does not read."""


class Host(Protocol):
    """What serves messages, ticks and requests of a command loop in C (struct fjr_controller_loop)."""

    name: str
    """Of the loop, in a sentence about its failure."""

    def start(self, topics: CommandTopics, publishers: Sequence[Publisher], priority: int) -> None:
        """Begin to serve. topics: of the commands; publishers: by enum fjr_controller_output, those of topics first."""

    def run(self, kind: int, arguments: Any) -> None:
        """Let the C serve a request between two messages, and wait for it."""

    def hold(self, hold: bool) -> None:
        """Let messages wait from the end of the next request on, or take them again."""

    def stop(self) -> None:
        """Stop serving messages; requests are served by the caller."""

    def close(self) -> None:
        """Stop serving for good: destroy the subscription. Requests are still served by the caller."""

    @property
    def runs(self) -> bool:
        """Whether messages are served."""

    @property
    def failure(self) -> BaseException | str:
        """Why the loop has ended by itself."""


class NativeHost:
    """A thread in C, see controller_thread.h: no Python runs on it, and it allocates no memory."""

    name = "native command loop"

    def __init__(self, node: Node, program: Program, loop: Any) -> None:
        """Create the thread and subscribe to the states; loop: struct fjr_controller_loop*. Raise NativeError."""
        ffi, lib = program.ffi, program.lib
        self._program = program
        self._topic_names = [ffi.new("char[]", node.resolve_topic_name(topic).encode()) for topic in TOPICS]
        given = {"controller": loop, "node": ffi.cast("void*", node.handle.pointer), "topic": self._topic_names}
        self._thread = ffi.new("struct fjr_controller_thread*", given)
        loop.host = self._thread
        for name in ("publish", "has_others", "pause"):
            setattr(loop, name, ffi.addressof(lib, f"fjr_controller_{name}"))
        callbacks = (ffi.addressof(lib, f"fjr_controller_on_{name}") for name in ("message", "tick", "request", "end"))
        self._host = ffi.new("struct fjr_host*", (self._thread, *callbacks))
        self._states = NativeSubscription(node, JointState, names.JOINT_STATES, names.LATEST)
        self._loop = NativeLoop(program, self._host, [self._states])
        self._thread.loop = self._loop.pointer

    def start(self, topics: CommandTopics, publishers: Sequence[Publisher], priority: int) -> None:
        """Start the thread, at this SCHED_FIFO priority if the system allows it."""
        known, self._thread.silent = topics.known
        self._known = self._program.ffi.from_buffer(known)
        self._thread.known = self._known
        for k, publisher in enumerate(publishers):
            self._thread.publisher[k] = publisher_address(self._program, publisher)
        self._loop.use(publishers)
        self._loop.start(priority)

    def run(self, kind: int, arguments: Any) -> None:
        """Let the thread serve a request between two messages; without a thread serve it here."""
        self._loop.request(kind, arguments)

    def hold(self, hold: bool) -> None:
        """Let messages wait from the end of the next request on, or take them again."""
        self._loop.hold(hold)

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._loop.stop()

    def close(self) -> None:
        """End the thread and destroy the subscription, which the node does not know."""
        self._loop.stop()
        self._states.close()

    @property
    def runs(self) -> bool:
        """Whether the thread runs."""
        return self._loop.runs

    @property
    def failure(self) -> str:
        """Why the thread has failed."""
        return self._loop.reason


class RclpyHost:
    """Callbacks of the node's executor: for a law in Python, or where no native thread can be built."""

    name = "command loop"

    def __init__(
        self,
        node: Node,
        program: Program,
        loop: Any,
        raise_failure: Callable[[], None],
        read: Callable[[], None],
    ) -> None:
        """Subscribe to the states.

        raise_failure: raises the error of Python code that the last message called. read: takes records from the queue.
        """
        ffi = program.ffi
        self._node, self._program, self._struct, self._raise_failure = node, program, loop, raise_failure
        self._read, self._next = read, ffi.new("int64_t*")
        self.runs, self.failure = False, ""  # type: bool, BaseException | str
        self._callbacks = (
            ffi.callback("int(void*, int32_t, const struct fjr_message*)", self._publish, error=2),
            ffi.callback("int(void*)", lambda _: self._topics.others_appeared(), error=1),
            ffi.callback("int(void*)", self._pause, error=2),
        )
        loop.publish, loop.has_others, loop.pause = self._callbacks
        self._states = node.create_subscription(JointState, names.JOINT_STATES, self._on_state, names.LATEST, raw=True)
        self._timer = node.create_timer(1.0, self._on_tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._timer.cancel()

    def start(self, topics: CommandTopics, publishers: Sequence[Publisher], priority: int) -> None:
        """Begin to serve; the executor has the priority of its process."""
        self._topics, self._publishers = topics, publishers
        self.runs, self.failure = True, ""
        self._on_tick()

    def run(self, kind: int, arguments: Any) -> None:
        """Serve a request."""
        self._check(self._program.lib.fjr_controller_request(self._struct, kind, arguments))

    def hold(self, hold: bool) -> None:
        """Do nothing: the executor serves no message meanwhile."""

    def stop(self) -> None:
        """Stop serving messages."""
        if self.runs:
            self.runs = False
            self._timer.cancel()

    def close(self) -> None:
        """Destroy subscription and timer; a second call does nothing."""
        self.stop()
        self._node.destroy_subscription(self._states)
        self._node.destroy_timer(self._timer)

    def _on_state(self, message: bytes) -> None:
        if self.runs:
            now = time.monotonic_ns()
            if message[1:2] == BIG_ENDIAN:
                message = _little_endian(message)
            data = self._program.ffi.from_buffer("uint8_t[]", message)
            self._check(self._program.lib.fjr_controller_message(self._struct, 0, data, len(message), now))
            self._tick_by(self._program.lib.fjr_controller_waits(self._struct))

    def _on_tick(self) -> None:
        self._timer.cancel()
        self._due = NO_TIME
        if self.runs:
            self._check(self._program.lib.fjr_controller_tick(self._struct, time.monotonic_ns(), self._next))
            self._tick_by(int(self._next[0]))

    def _tick_by(self, due: int) -> None:
        """Let the next tick come at a time [ns, steady clock], unless it comes earlier anyway."""
        if due < self._due and self.runs:
            self._due = due
            self._timer.timer_period_ns = max(due - time.monotonic_ns(), 1)
            self._timer.reset()

    def _check(self, outcome: int) -> None:
        """After a failure, end the loop in C, which sends the stop effort, and serve no more messages."""
        try:
            self._raise_failure()
        except Exception as error:
            self.failure, outcome = error, self._program.lib.FJR_FAILED
        if outcome == self._program.lib.FJR_FAILED and self.runs:
            reason = self._struct.reason
            self.failure = self.failure or (self._program.ffi.string(reason).decode() if reason else "unknown")
            self.stop()
            self._program.lib.fjr_controller_end(self._struct, outcome)

    def _publish(self, _: Any, output: int, message: Any) -> int:
        try:
            self._publishers[output].publish(bytes(self._program.ffi.buffer(message.bytes, message.size)))
        except Exception as error:
            self.failure = error
            return int(self._program.lib.FJR_FAILED)
        return 0

    def _pause(self, _: Any) -> int:
        self._read()
        return 0


def _little_endian(message: bytes) -> bytes:
    """Return a serialised JointState in the byte order of this machine; one that is none is returned as it is."""
    try:
        return bytes(serialize_message(deserialize_message(message, JointState)))
    except rclpy_implementation.RMWError:
        return message
