# SPDX-License-Identifier: Apache-2.0
"""Read topics in batches, with little load on the measured nodes."""

from __future__ import annotations

import struct
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
HEADER, STAMP = 4, struct.Struct("<iI")  # a serialised JointState begins with its stamp
PAUSE = 0.05  # s between two reads of the queues


@dataclass(frozen=True)
class Seen:
    """A message: stamp and send time [ns]."""

    stamp: int
    sent: int


class Tap:
    """Context manager: a node that reads JointStates from its queues without an executor."""

    def __enter__(self) -> Tap:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("fjr_bench_tap", context=self._context, start_parameter_services=False)
        return self

    def __exit__(self, *_: object) -> None:
        self._node.destroy_node()
        self._context.try_shutdown()

    def next(self, topic: str, longest: float) -> Seen:
        """Return one message, subscribing only for it; raise TimeoutError after `longest` [s]."""
        subscription = self._subscribe(topic)
        try:
            return self._wait(subscription, longest)
        finally:
            self._node.destroy_subscription(subscription)

    def sent(self, topics: list[str], seconds: float, longest: float) -> list[NDArray[np.int64]]:
        """Return the send times [ns] of each topic, as `messages` does."""
        return [found[:, 1] for found in self.messages(topics, seconds, longest)]

    def messages(self, topics: list[str], seconds: float, longest: float) -> list[NDArray[np.int64]]:
        """Return stamps and send times (k, 2) [ns] of each topic, from the first message of the last topic on.

        seconds: how long. TimeoutError when a topic is silent for `longest` seconds at first.
        """
        subscriptions = [self._subscribe(topic) for topic in topics]
        for subscription in subscriptions:
            self._wait(subscription, longest)
        seen: list[list[tuple[int, int]]] = [[] for _ in topics]
        end = perf_counter() + seconds
        while perf_counter() < end:
            time.sleep(PAUSE)
            for found, subscription in zip(seen, subscriptions, strict=True):
                found += _drained(subscription)
        for subscription in subscriptions:
            self._node.destroy_subscription(subscription)
        return [np.array(found, dtype=np.int64).reshape(-1, 2) for found in seen]

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


def _drained(subscription: Subscription) -> list[tuple[int, int]]:
    """Return stamp and send time [ns] of each waiting message."""
    seen = []
    while (taken := subscription.handle.take_message(JointState, True)) is not None:
        sec, nanosec = STAMP.unpack_from(taken[0], HEADER)
        seen.append((sec * 1_000_000_000 + nanosec, taken[1]["source_timestamp"]))
    return seen
