# SPDX-License-Identifier: Apache-2.0
"""Read topics in batches, with little load on the measured nodes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from fjr_monitor.recording.bag import header_stamp
from fjr_msgs_py.node.participant import own_node

DEPTH = 5000
PAUSE = 0.05  # s between two reads of the queues


class Seen(NamedTuple):
    """A message: stamp and send time [ns], and its serialised data."""

    stamp: int
    sent: int
    data: bytes = b""


class Tap:
    """Context manager: a node that reads JointStates from its queues without an executor."""

    def __enter__(self) -> Tap:
        self._own = own_node("fjr_bench_tap")
        self.node = self._own.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._own.__exit__(None, None, None)

    def next(self, topic: str, longest: float) -> Seen:
        """Return one message, subscribing only for it; raise TimeoutError after `longest` [s]."""
        with self.listening([topic], longest) as heard:
            return heard.seen[0][0]

    @contextmanager
    def listening(self, topics: list[str], longest: float) -> Iterator[Heard]:
        """Listen to topics inside the block, which begins with the first message of the last of them."""
        subscribe, quality = self.node.create_subscription, QoSProfile(depth=DEPTH)
        subscriptions = [subscribe(JointState, topic, lambda _: None, quality, raw=True) for topic in topics]
        try:
            yield Heard(subscriptions, [[self._wait(subscription, longest)] for subscription in subscriptions])
        finally:
            for subscription in subscriptions:
                self.node.destroy_subscription(subscription)

    def _wait(self, subscription: Subscription, longest: float) -> Seen:
        end = perf_counter() + longest
        while (taken := next(waiting(subscription, JointState, raw=True), None)) is None:
            if perf_counter() > end:
                raise TimeoutError(f"{subscription.topic} was silent for {longest:g} s; expected a message")
            time.sleep(1e-3)
        return _seen(taken)


@dataclass(frozen=True)
class Heard:
    """What a tap hears: subscriptions, and their messages so far."""

    subscriptions: list[Subscription]
    seen: list[list[Seen]]

    def collect(self, seconds: float) -> None:
        """Read the queues for a time."""
        end = perf_counter() + seconds
        while perf_counter() < end:
            time.sleep(PAUSE)
            self.drain()

    def until(self, happened: Callable[[], object], longest: float, what: str) -> None:
        """Read the queues until `happened()`; raise TimeoutError after `longest` [s]."""
        end = perf_counter() + longest
        while not happened():
            if perf_counter() > end:
                raise TimeoutError(f"waited {longest:g} s for {what}")
            self.collect(PAUSE)

    def drain(self) -> None:
        """Empty the queues, which hold DEPTH messages."""
        for found, subscription in zip(self.seen, self.subscriptions, strict=True):
            found += map(_seen, waiting(subscription, JointState, raw=True))

    def messages(self) -> list[NDArray[np.int64]]:
        """Return stamps and send times (k, 2) [ns] of each topic."""
        return [np.array([each[:2] for each in found], dtype=np.int64).reshape(-1, 2) for found in self.seen]

    def values(self, k: int, *fields: str) -> NDArray[np.float64]:
        """Return these fields of the messages of the k-th topic, side by side."""
        messages = (deserialize_message(each.data, JointState) for each in self.seen[k])
        return np.array([np.concatenate([getattr(message, name) for name in fields]) for message in messages])


def waiting(subscription: Subscription, kind: Any, raw: bool = False) -> Iterator[tuple[Any, Any]]:
    """Take the messages of a kind, or their raw data, that wait in a queue, each with its times."""
    while (taken := subscription.handle.take_message(kind, raw)) is not None:
        yield taken


def _seen(taken: tuple[Any, Any]) -> Seen:
    data, known = taken
    return Seen(header_stamp(data), known["source_timestamp"], data)
