# SPDX-License-Identifier: Apache-2.0
"""What a relay may do to the states that pass through it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

from sensor_msgs.msg import JointState

from faults.relay import Tamper


def dropped(message: JointState) -> Iterable[JointState]:
    return ()


def not_a_number(message: JointState) -> Iterable[JointState]:
    """Positions and velocities that are NaN and infinite by turns."""
    bad = math.nan if message.header.stamp.nanosec // 1_000_000 % 2 else math.inf
    message.position[0] = bad
    message.velocity[-1] = -bad
    yield message


def renamed(message: JointState) -> Iterable[JointState]:
    message.name = [f"{name}_of_another_arm" for name in message.name]
    yield message


def twice(message: JointState) -> Iterable[JointState]:
    return (message, message)


def frozen() -> Tamper:
    """The first message again and again."""
    first: list[JointState] = []

    def tamper(message: JointState) -> Iterable[JointState]:
        first.append(message)
        del first[1:]
        yield first[0]

    return tamper


def aged(samples: int) -> Tamper:
    """Before each message one that is `samples` older."""
    past: deque[JointState] = deque(maxlen=samples + 1)

    def tamper(message: JointState) -> Iterable[JointState]:
        past.append(message)
        yield past[0]
        yield message

    return tamper


def jumped(seconds: int) -> Tamper:
    """Stamps moved by whole seconds."""

    def tamper(message: JointState) -> Iterable[JointState]:
        message.header.stamp.sec += seconds
        yield message

    return tamper
