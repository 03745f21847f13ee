# SPDX-License-Identifier: Apache-2.0
"""Read serialised joint states in place if their layout is that of the last message."""

from __future__ import annotations

import math

from sensor_msgs.msg import JointState

from ..joint_states import FIRST_UNSENDABLE, Array, JointSample, StateReader, deserialised
from .layout import StateLayout


class SerialisedStates:
    """Reader of serialised JointStates, equivalent to StateReader; a sample is valid until the next one is read."""

    def __init__(self, reader: StateReader) -> None:
        self._reader = reader
        self._layout: StateLayout | None = None  # of the last message that can be read in place
        self._sides: tuple[Array, ...] = ()

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
        message = deserialised(data, JointState)
        sample = self._reader.read(message)
        self._learn(data, message)
        if self._layout is not None:
            self._sides = self._reader.sides(**self._layout.values)
        return sample

    def _learn(self, data: bytes, message: JointState) -> None:
        """Store the layout of a valid message."""
        layout = StateLayout(data, message) if self._reader.takes_as_is(message) else None
        self._layout = layout if layout is not None and layout.trusted else None
