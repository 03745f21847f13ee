# SPDX-License-Identifier: Apache-2.0
"""Hosts of the command loop (struct fjr_controller_loop): a native thread, or callbacks of rclpy's executor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from fjr_msgs_py import names
from fjr_msgs_py.native.loop import NativeLoop, NativeSubscription, RclpyHost
from fjr_msgs_py.native.program import Program
from fjr_msgs_py.node.conflicting_publishers import ConflictingPublishers

BIG_ENDIAN = b"\x00"
"""Second byte of a serialised message (CDR) in the other byte order, which the C does not read."""


def callbacks(program: Program, loop: Any) -> dict[str, Any]:
    """Return the fields of struct fjr_callbacks for a command loop, struct fjr_controller_loop*."""
    functions = ("message", "tick", "request", "end")
    of = {f"on_{name}": program.ffi.addressof(program.lib, f"fjr_controller_{name}") for name in functions}
    return {"self": loop, **of}


def reason_of(program: Program, loop: Any) -> str:
    """Return why the command loop has failed, "" if the reason is its host's."""
    return program.ffi.string(loop.reason).decode() if loop.reason else ""


class NativeControllerHost(NativeLoop):
    """A thread in C: no Python runs on it, and it allocates no memory."""

    name = "native command loop"

    def __init__(self, node: Node, program: Program, loop: Any) -> None:
        """Create the thread and subscribe to the states; loop: struct fjr_controller_loop*. Raise NativeError."""
        states = NativeSubscription(node, JointState, names.JOINT_STATES, names.LATEST)
        super().__init__(program, callbacks(program, loop), [states])
        self._struct, loop.host = loop, self.pointer
        loop.publish, loop.pause, loop.has_others = (
            program.ffi.addressof(program.lib, f"fjr_{name}") for name in ("loop_publish", "loop_pause", "has_others")
        )

    def serve(self, topics: ConflictingPublishers, priority: int) -> None:
        """Start the thread, at this SCHED_FIFO priority if the system allows it; topics: of the commands."""
        self._struct.known = topics.known(self._program)
        self.start(priority)

    @property
    def reason(self) -> str:
        """Why the thread has failed; empty if it has not."""
        return reason_of(self._program, self._struct) or super().reason


class RclpyControllerHost(RclpyHost):
    """Callbacks of the node's executor: for a law in Python, or where no native thread can be built."""

    name = "command loop"

    def __init__(
        self, node: Node, program: Program, loop: Any, raise_failure: Callable[[], None], read: Callable[[], None]
    ) -> None:
        """Subscribe to the states.

        raise_failure: raises the error of Python code that the last message called. read: takes records from the queue.
        """
        super().__init__(node, program, callbacks(program, loop), JointState, names.JOINT_STATES)
        self._struct, self._raise_failure, self._read, self.runs = loop, raise_failure, read, False
        self._called = (
            program.ffi.callback("int(void*)", self._pause, error=program.lib.FJR_FAILED),
            program.ffi.callback("int(void*)", lambda _: self._topics.others_appeared(), error=1),
        )
        loop.publish, (loop.pause, loop.has_others) = self.publish, self._called

    def serve(self, topics: ConflictingPublishers, _: int) -> None:
        """Begin to serve, as NativeControllerHost.serve; the executor has the priority of its process."""
        self._topics = topics
        self.runs, self.reason = True, ""
        self._tick()

    def request(self, kind: int, arguments: Any) -> None:
        """Serve a request of enum fjr_controller_request."""
        self._goes_on(self._program.lib.fjr_controller_request(self._struct, kind, arguments))

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
            super()._serve_message(_little_endian(message) if message[1:2] == BIG_ENDIAN else message)

    def _tick(self) -> None:
        if self.runs:
            super()._tick()

    def _goes_on(self, outcome: int) -> bool:
        """After a failure, end the loop in C, which sends the stop effort, and serve no more messages."""
        try:
            self._raise_failure()
        except Exception as error:
            self.reason, outcome = error, self._program.lib.FJR_FAILED
        if outcome == self._program.lib.FJR_FAILED and self.runs:
            self.reason = self.reason or reason_of(self._program, self._struct) or "unknown"
            self.stop()
            self._program.lib.fjr_controller_end(self._struct, outcome)
        return self.runs

    def _pause(self, _: Any) -> int:
        self._read()
        return 0


def _little_endian(message: bytes) -> bytes:
    """Return a serialised JointState in the byte order of this machine; one that is none is returned as it is."""
    try:
        return bytes(serialize_message(deserialize_message(message, JointState)))
    except rclpy_implementation.RMWError:
        return message
