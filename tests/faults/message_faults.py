# SPDX-License-Identifier: Apache-2.0
"""Modifications of states in the relay; each function returns a new one, which may remember messages."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

from sensor_msgs.msg import JointState

from faults.relay import Tamper


def dropped() -> Tamper:
    return lambda message: ()


def twice() -> Tamper:
    return lambda message: (message, message)


def not_a_number() -> Tamper:
    """Make a position and a velocity alternately NaN and infinite."""

    def tamper(message: JointState) -> Iterable[JointState]:
        bad = math.nan if message.header.stamp.nanosec // 1_000_000 % 2 else math.inf
        message.position[0] = bad
        message.velocity[-1] = -bad
        yield message

    return tamper


def renamed() -> Tamper:
    def tamper(message: JointState) -> Iterable[JointState]:
        message.name = [f"{name}_of_another_arm" for name in message.name]
        yield message

    return tamper


def frozen() -> Tamper:
    """Repeat the first message."""
    first: list[JointState] = []

    def tamper(message: JointState) -> Iterable[JointState]:
        first.append(message)
        del first[1:]
        yield first[0]

    return tamper


def aged(samples: int) -> Tamper:
    """Send a message that is `samples` older before each message."""
    past: deque[JointState] = deque(maxlen=samples + 1)

    def tamper(message: JointState) -> Iterable[JointState]:
        past.append(message)
        yield past[0]
        yield message

    return tamper


def jumped(seconds: int) -> Tamper:
    """Shift the stamps by whole seconds."""

    def tamper(message: JointState) -> Iterable[JointState]:
        message.header.stamp.sec += seconds
        yield message

    return tamper
