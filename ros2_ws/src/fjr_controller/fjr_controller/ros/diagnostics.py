# SPDX-License-Identifier: Apache-2.0
"""What the controller tells of itself: counters on /diagnostics, events on ~/events, each kind once in the log."""

from __future__ import annotations

import inspect
import sys

from rclpy.node import Node

from fjr_msgs_py.messages.events import EventWriter
from fjr_msgs_py.node.diagnostics import Health

from ..tracking.events import Event
from ..tracking.tracker import Tracker

RECEIVED, ANSWERED = "states received", "states answered"
EXPECTED = (
    RECEIVED,
    ANSWERED,
    "states repeated",
    "recoveries",
    "resumes",
    "gains changed",
    "settings changed",
    "references changed",
    "holds",
    "trajectories accepted",
    "trajectories given up",
)


class Reports(Health):
    """The counters of the node and of its tracker together, and the events of both."""

    def __init__(self, node: Node, tracker: Tracker, events: EventWriter, robot: str) -> None:
        """robot: its name, for the diagnostics."""
        super().__init__(node, (RECEIVED, ANSWERED), robot)
        self._tracker, self._events = tracker, events
        self._expected |= set(EXPECTED)
        inspect.getframeinfo(
            sys._getframe()
        )  # what makes a first line in the log cost 25 ms is done before states come

    def event(self, event: Event) -> None:
        """Publish an event, and count and log it by its level and kind."""
        if event.level == "info":
            self.count[event.kind] += 1
            if self.is_new(event.kind):
                self._node.get_logger().info(event.sentence)
        elif event.level == "error":
            self.error(event.kind, event.sentence)
        else:
            self.warn(event.kind, event.sentence)
        self._events.publish(event.level, event.kind, event.sentence, event.values)

    def reached(self, kind: str, sentence: str) -> None:
        """Publish that something has begun, and log it the first time."""
        if self.is_new(kind):
            self._node.get_logger().info(sentence)
        self._events.publish("info", kind, sentence)

    def empty(self) -> None:
        """Publish what has happened in the tracker since the last call."""
        while self._tracker.events:
            self.event(self._tracker.events.popleft())

    def publish(self) -> None:
        """Publish the counters; a kind that the tracker counts, too, has the tracker's number."""
        for kind, number in self._tracker.counters.items():
            self.count[kind] = max(number, self.count[kind])
        for name, seconds in self._tracker.seconds.items():
            self.value(f"seconds {name}", f"{seconds:.3f}")
        self.value("state", self._tracker.state.value)
        super().publish()
