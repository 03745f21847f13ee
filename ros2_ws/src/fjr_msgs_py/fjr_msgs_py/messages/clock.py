# SPDX-License-Identifier: Apache-2.0
"""Simulated time on /clock."""

from __future__ import annotations

from rosgraph_msgs.msg import Clock

from .cdr.layout import Form
from .joint_states import nanoseconds


def time_of(message: Clock) -> int:
    """Return the time of a message [ns]."""
    return nanoseconds(message.clock)


CLOCK_LAYOUT = Form([0, 0])
"""Layout of a serialised message, whose stamp is its time."""
