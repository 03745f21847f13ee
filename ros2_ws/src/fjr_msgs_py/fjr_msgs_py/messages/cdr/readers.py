# SPDX-License-Identifier: Apache-2.0
"""Read serialised joint states and commands in place if their layout is that of the last message."""

from __future__ import annotations

import math
from typing import Generic, TypeVar

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from ..joint_states import FIRST_UNSENDABLE, Array, EffortReader, JointSample, MessageError, StateReader
from .layout import StateLayout

Reader = TypeVar("Reader", StateReader, EffortReader)


class _Serialised(Generic[Reader]):
    """A reader of messages with the layout of the last message that can be read in place."""

    def __init__(self, reader: Reader) -> None:
        self._reader: Reader = reader
        self._layout: StateLayout | None = None
        self._sides: tuple[Array, ...] = ()

    def _message(self, data: bytes) -> JointState:
        try:
            return deserialize_message(data, JointState)
        except rclpy_implementation.RMWError:
            raise MessageError("not a message", f"{len(data)} bytes are no JointState; expected one") from None

    def _learn(self, data: bytes, message: JointState) -> None:
        """Store the layout of a valid message."""
        layout = StateLayout(data, message) if self._reader.takes_as_is(message) else None
        self._layout = layout if layout is not None and layout.trusted else None


class SerialisedStates(_Serialised[StateReader]):
    """Reader of serialised JointStates, equivalent to StateReader; a sample is valid until the next one is read."""

    def read(self, data: bytes) -> JointSample:
        """Return the state in the order of the joints; raises MessageError for an invalid message."""
        layout = self._layout
        if (
            layout is not None
            and layout.taken(data)
            and 0 < layout.stamp < FIRST_UNSENDABLE
            and layout.moving.dot(layout.moving) < math.inf
        ):
            return JointSample(layout.stamp, *self._sides)
        message = self._message(data)
        sample = self._reader.read(message)
        self._learn(data, message)
        if self._layout is not None:
            self._sides = self._reader.sides(**self._layout.values)
        return sample


class SerialisedEfforts(_Serialised[EffortReader]):
    """Reader of serialised named commands, equivalent to EffortReader.read_named."""

    def read(self, data: bytes) -> tuple[int, Array]:
        """Return stamp [ns] of the answered state and efforts (n,) [N m]; raises MessageError."""
        layout = self._layout
        if layout is not None and layout.taken(data):
            effort = layout.values["effort"]
            if effort.dot(effort) < math.inf:
                return layout.stamp, effort.copy()
        message = self._message(data)
        answer = self._reader.read_named(message)
        self._learn(data, message)
        return answer
