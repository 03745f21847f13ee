# SPDX-License-Identifier: Apache-2.0
"""Report counters on /diagnostics and events on ~/events; log each kind of event once."""

from __future__ import annotations

import inspect
import sys

from rclpy.node import Node

from fjr_msgs_py.messages.events import STAMP, EventWriter
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
    "efforts rate limited",
    "gains changed",
    "settings changed",
    "references changed",
    "holds",
    "trajectories accepted",
    "trajectories given up",
)


class Reports(Health):
    """Counters and events of the node together with those of its tracker."""

    def __init__(self, node: Node, tracker: Tracker, events: EventWriter, robot: str) -> None:
        """Create the publisher; robot: name in the hardware_id of the diagnostics."""
        super().__init__(node, (RECEIVED, ANSWERED), robot)
        self._tracker, self._events = tracker, events
        self._expected |= set(EXPECTED)
        inspect.getframeinfo(sys._getframe())  # the first line of the log costs 25 ms: pay it before samples arrive

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
        values = dict(event.values) if event.stamp is None else {**event.values, STAMP: event.stamp}
        self._events.publish(event.level, event.kind, event.sentence, values)

    def announce(self, kind: str, sentence: str) -> None:
        """Publish an event that is not counted, and log it the first time."""
        if self.is_new(kind):
            self._node.get_logger().info(sentence)
        self._events.publish("info", kind, sentence)

    def publish_events(self) -> None:
        """Publish the events of the tracker since the last call."""
        while self._tracker.events:
            self.event(self._tracker.events.popleft())

    def publish(self) -> None:
        """Publish the counters; the tracker's number is used for a kind that both count."""
        for kind, number in self._tracker.counters.items():
            self.count[kind] = max(number, self.count[kind])
        for name, seconds in self._tracker.seconds.items():
            self.value(f"seconds {name}", f"{seconds:.3f}")
        self.value("state", self._tracker.state.value)
        super().publish()
