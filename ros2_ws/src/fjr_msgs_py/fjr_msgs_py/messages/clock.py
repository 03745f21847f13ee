# SPDX-License-Identifier: Apache-2.0
"""The time of whoever owns it, as /clock tells it."""

from __future__ import annotations

from rosgraph_msgs.msg import Clock


class ClockWriter:
    """One Clock message, filled again and again; valid until the next fill."""

    def __init__(self) -> None:
        self._message = Clock()
        self._clock = self._message.clock

    def fill(self, stamp: int) -> Clock:
        """The message with this time [ns]."""
        self._clock.sec, self._clock.nanosec = divmod(stamp, 1_000_000_000)
        return self._message
