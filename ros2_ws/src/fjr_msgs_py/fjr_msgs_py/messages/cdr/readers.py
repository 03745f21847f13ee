# SPDX-License-Identifier: Apache-2.0
"""Serialised joint states and commands read without making messages of them, where they are like the ones before."""

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
    """A reader of messages, and the layout of the last one that it takes as it is."""

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
        """Remember the layout of a message that was read without an error."""
        layout = StateLayout(data, message) if self._reader.takes_as_is(message) else None
        self._layout = layout if layout is not None and layout.trusted else None


class SerialisedStates(_Serialised[StateReader]):
    """Reads serialised JointStates as a StateReader does; a sample's arrays are good until the next one is read."""

    def read(self, data: bytes) -> JointSample:
        """The state in the order of the joints; raises MessageError for anything that is not one."""
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
    """Reads serialised, stamped and named commands as an EffortReader does."""

    def read(self, data: bytes) -> tuple[int, Array]:
        """Stamp [ns] of the answered state and efforts (n,) [N m]; raises MessageError."""
        layout = self._layout
        if layout is not None and layout.taken(data):
            effort = layout.values["effort"]
            if effort.dot(effort) < math.inf:
                return layout.stamp, effort.copy()
        message = self._message(data)
        answer = self._reader.read_named(message)
        self._learn(data, message)
        return answer
