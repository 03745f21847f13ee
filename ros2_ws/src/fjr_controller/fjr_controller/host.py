# SPDX-License-Identifier: Apache-2.0
"""Hosts of the command loop (struct fjr_controller_loop): a native thread, or callbacks of rclpy's executor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from fjr_msgs_py import names
from fjr_msgs_py.native.host import NativeHost, RclpyHost
from fjr_msgs_py.native.program import Program

from .command_topics import TOPICS, CommandTopics

BIG_ENDIAN = b"\x00"
"""Second byte of a serialised message (CDR) in the other byte order, which the C does not read."""


class NativeControllerHost(NativeHost):
    """A thread in C, see controller_thread.h: no Python runs on it, and it allocates no memory."""

    name = "native command loop"

    def __init__(self, node: Node, program: Program, loop: Any) -> None:
        """Create the thread and subscribe to the states; loop: struct fjr_controller_loop*. Raise NativeError."""
        ffi, lib = program.ffi, program.lib
        self._topic_names = [ffi.new("char[]", node.resolve_topic_name(topic).encode()) for topic in TOPICS]
        given = {"controller": loop, "node": ffi.cast("void*", node.handle.pointer), "topic": self._topic_names}
        loop.host = state = ffi.new("struct fjr_controller_thread*", given)
        for name in ("publish", "has_others", "pause"):
            setattr(loop, name, ffi.addressof(lib, f"fjr_controller_{name}"))
        super().__init__(node, program, "fjr_controller", state, JointState, names.JOINT_STATES)

    def serve(self, topics: CommandTopics, publishers: Sequence[Publisher], priority: int) -> None:
        """Start the thread, at this SCHED_FIFO priority if the system allows it.

        topics: of the commands. publishers: by enum fjr_controller_output, those of topics first.
        """
        known, self.state.silent = topics.known
        self._known = self._program.ffi.from_buffer(known)
        self.state.known = self._known
        self.use(publishers)
        self.start(priority)


class RclpyControllerHost(RclpyHost):
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
        super().__init__(node, program, JointState, names.JOINT_STATES)
        self._struct, self._raise_failure, self._read, self.runs = loop, raise_failure, read, False
        self._callbacks = (
            program.ffi.callback("int(void*)", lambda _: self._topics.others_appeared(), error=1),
            program.ffi.callback("int(void*)", self._pause, error=2),
        )
        loop.publish, (loop.has_others, loop.pause) = self.publish, self._callbacks

    def serve(self, topics: CommandTopics, publishers: Sequence[Publisher], priority: int) -> None:
        """Begin to serve, as NativeControllerHost.serve; the executor has the priority of its process."""
        self._topics = topics
        self.use(publishers)
        self.runs, self.reason = True, ""
        self._tick()

    def request(self, kind: int, arguments: Any) -> None:
        """Serve a request of enum fjr_controller_request."""
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
        super().close()

    def _serve_message(self, message: bytes) -> None:
        if self.runs:
            now = self.now()
            if message[1:2] == BIG_ENDIAN:
                message = _little_endian(message)
            data = self._program.ffi.from_buffer("uint8_t[]", message)
            self._check(self._program.lib.fjr_controller_message(self._struct, 0, data, len(message), now))
            self._tick_by(self._program.lib.fjr_controller_waits(self._struct))

    def _serve_tick(self) -> None:
        if self.runs:
            self._check(self._program.lib.fjr_controller_tick(self._struct, self.now(), self._next))
            self._tick_by(int(self._next[0]))

    def _tick_by(self, due: int) -> None:
        if self.runs:  # still, after the message or tick
            super()._tick_by(due)

    def _check(self, outcome: int) -> None:
        """After a failure, end the loop in C, which sends the stop effort, and serve no more messages."""
        try:
            self._raise_failure()
        except Exception as error:
            self.reason, outcome = error, self._program.lib.FJR_FAILED
        if outcome == self._program.lib.FJR_FAILED and self.runs:
            reason = self._struct.reason
            self.reason = self.reason or (self._program.ffi.string(reason).decode() if reason else "unknown")
            self.stop()
            self._program.lib.fjr_controller_end(self._struct, outcome)

    def _pause(self, _: Any) -> int:
        self._read()
        return 0


def _little_endian(message: bytes) -> bytes:
    """Return a serialised JointState in the byte order of this machine; one that is none is returned as it is."""
    try:
        return bytes(serialize_message(deserialize_message(message, JointState)))
    except rclpy_implementation.RMWError:
        return message
