# SPDX-License-Identifier: Apache-2.0
"""Looks at topics from outside, in batches, so that it takes little of what it measures."""

from __future__ import annotations

import time
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.context import Context
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from fjr_msgs_py.messages.joint_states import nanoseconds

DEPTH = 5000
PAUSE = 0.05  # s between two looks into the queues


@dataclass(frozen=True)
class Seen:
    """A message: its stamp, and when its publisher sent it [ns]."""

    stamp: int
    sent: int


class Tap:
    """A node that takes JointStates off its queues without an executor; a context manager."""

    def __enter__(self) -> Tap:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("fjr_bench_tap", context=self._context, start_parameter_services=False)
        return self

    def __exit__(self, *_: object) -> None:
        self._node.destroy_node()
        self._context.try_shutdown()

    def next(self, topic: str, longest: float) -> Seen:
        """One message; nothing is subscribed before and after. TimeoutError after so many seconds."""
        subscription = self._subscribe(topic)
        try:
            return self._wait(subscription, longest)
        finally:
            self._node.destroy_subscription(subscription)

    def sent(self, topics: list[str], seconds: float, longest: float) -> list[NDArray[np.int64]]:
        """When the messages of each topic were sent [ns], for so many seconds from the first message of the last one.

        TimeoutError when a topic is silent for `longest` seconds at first.
        """
        subscriptions = [self._subscribe(topic) for topic in topics]
        for subscription in subscriptions:
            self._wait(subscription, longest)
        times: list[list[int]] = [[] for _ in topics]
        end = perf_counter() + seconds
        while perf_counter() < end:
            time.sleep(PAUSE)
            for found, subscription in zip(times, subscriptions, strict=True):
                found += _drained(subscription)
        for subscription in subscriptions:
            self._node.destroy_subscription(subscription)
        return [np.array(found, dtype=np.int64) for found in times]

    def _subscribe(self, topic: str) -> Subscription:
        return self._node.create_subscription(JointState, topic, lambda _: None, QoSProfile(depth=DEPTH), raw=True)

    def _wait(self, subscription: Subscription, longest: float) -> Seen:
        end = perf_counter() + longest
        while (taken := subscription.handle.take_message(JointState, True)) is None:
            if perf_counter() > end:
                raise TimeoutError(f"{subscription.topic} was silent for {longest:g} s; expected a message")
            time.sleep(1e-3)
        data, info = taken
        return Seen(nanoseconds(deserialize_message(data, JointState).header.stamp), info["source_timestamp"])


def _drained(subscription: Subscription) -> list[int]:
    times = []
    while (taken := subscription.handle.take_message(JointState, True)) is not None:
        times.append(taken[1]["source_timestamp"])
    return times
