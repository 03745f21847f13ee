# SPDX-License-Identifier: Apache-2.0
"""Subscriptions, publishers and messages of a node, as the C of a native loop uses them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.type_support import check_is_valid_msg_type

from ..messages.cdr.layout import HEADER, Form
from .program import Program

NAMES_ROOM = 1 << 13  # bytes of a list of names that is compared instead of looked up


class NativeSubscription:
    """A subscription of a node that no executor serves, so that a native loop alone takes its messages.

    Incompatible publishers are logged by the executor of the node, as for any other subscription.
    """

    def __init__(self, node: Node, kind: type, topic: str, qos: QoSProfile) -> None:
        self._node, group = node, node.default_callback_group
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

    def close(self) -> None:
        """Destroy the subscription; a second call does nothing."""
        if self._open:
            self._open = False
            for handler in self._subscription.event_handlers:
                self._node.remove_waitable(handler)
            self._subscription.destroy()


def publisher_address(program: Program, publisher: Publisher) -> Any:
    """Return the rcl_publisher_t* of a publisher."""
    return program.ffi.cast("void*", publisher.handle.pointer)


class NativeMessage:
    """A serialised message as struct fjr_message; `pointer` is valid as long as the object lives."""

    def __init__(self, program: Program, form: Form, lengths: Sequence[int]) -> None:
        """Lay out a message; lengths: of its sequences of numbers."""
        ffi = program.ffi
        self._buffer = bytearray(HEADER) + form.empty()
        self._view = ffi.from_buffer(self._buffer)
        offsets = [8 * start - HEADER for start in form.starts]
        self.pointer = ffi.new(
            "struct fjr_message*",
            {
                "bytes": ffi.cast("uint8_t*", self._view) + HEADER,
                "size": len(self._buffer) - HEADER,
                "at": offsets,
                "length": list(lengths),
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
