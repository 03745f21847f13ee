# SPDX-License-Identifier: Apache-2.0
"""Report the messages that a native loop has refused, with the sentences of the reader in Python."""

from __future__ import annotations

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from fjr_msgs_py.messages.joint_states import MessageError, StateReader
from fjr_msgs_py.native.loop import LARGEST
from fjr_msgs_py.native.program import Program
from fjr_msgs_py.node.diagnostics import Health


class Refusals:
    """Count refused messages by kind and log the first of each; `pointer` is a struct fjr_refusals*."""

    def __init__(self, program: Program, reader: StateReader, health: Health) -> None:
        ffi = program.ffi
        self._reader, self._health, self._ffi = reader, health, ffi
        kinds = len(ffi.new("struct fjr_refusals*").count)
        self._first = ffi.new("uint8_t[]", kinds * LARGEST)
        self.pointer = ffi.new("struct fjr_refusals*", {"room": LARGEST, "first": self._first})
        self._errors: dict[int, MessageError] = {}
        self._reported = [0] * kinds

    def report(self) -> None:
        """Report what was refused since the last call."""
        for kind, count in enumerate(self.pointer.count):
            for _ in range(count - self._reported[kind]):
                self._health.refuse("state", self._error(kind))
            self._reported[kind] = count

    def _error(self, kind: int) -> MessageError:
        if kind not in self._errors:
            size = self.pointer.size[kind]
            self._errors[kind] = self._reason(bytes(self._ffi.buffer(self._first + kind * LARGEST, size)))
        return self._errors[kind]

    def _reason(self, data: bytes) -> MessageError:
        """Return the error with which the reader refuses the message."""
        try:
            self._reader.read(deserialize_message(data, JointState))
        except rclpy_implementation.RMWError:
            pass
        except MessageError as error:
            return error
        return MessageError("not a message", f"{len(data)} bytes are no JointState; expected one")
