# SPDX-License-Identifier: Apache-2.0
"""Simulated time on /clock."""

from __future__ import annotations

from rosgraph_msgs.msg import Clock

from .joint_states import nanoseconds


def time_of(message: Clock) -> int:
    """Return the time of a message [ns]."""
    return nanoseconds(message.clock)


class ClockWriter:
    """Writer of one reused Clock message; it is valid until the next fill."""

    def __init__(self) -> None:
        self._message = Clock()
        self._clock = self._message.clock

    def fill(self, stamp: int) -> Clock:
        """Return the message with this time [ns]."""
        self._clock.sec, self._clock.nanosec = divmod(stamp, 1_000_000_000)
        return self._message
