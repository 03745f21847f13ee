# SPDX-License-Identifier: Apache-2.0
"""Report counters on /diagnostics and events on ~/events.

Each stop and refused trajectory is logged, every other kind of event and of refused message once until the next stop.
"""

from __future__ import annotations

import inspect
import sys
import time
from dataclasses import replace

from rclpy.node import Node

from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import POSITION_JUMP, STARTS_REFUSED, STOPS, Event
from fjr_msgs_py import names
from fjr_msgs_py.node.conflicting_publishers import node_of
from fjr_msgs_py.node.reports import STAMP, EventWriter, Health

RECEIVED, ANSWERED = "states received", "states answered"
TRAJECTORY_REFUSED = "trajectory refused"
CLOCK_JUMPS = "reference restarts", "forward jumps"
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
    """Counters and events of the node together with those of its control step."""

    def __init__(self, node: Node, step: ControlStep, events: EventWriter, robot: str) -> None:
        """Create the publisher; robot: name in the hardware_id of the diagnostics."""
        super().__init__(node, (RECEIVED, ANSWERED), robot)
        self._step, self._events, self._heard = step, events, (0, time.monotonic())  # states received, and when
        self._expected |= set(EXPECTED)
        inspect.getframeinfo(sys._getframe())  # the first line of the log costs 25 ms: pay it before samples arrive

    def event(self, event: Event) -> None:
        """Publish an event, and count and log it by its level and kind."""
        if event.kind.startswith(STOPS):
            self._logged.clear()  # what follows a stop, such as ~/resume, is news again
        elif event.kind.startswith((STARTS_REFUSED, TRAJECTORY_REFUSED)):
            self._logged.discard(event.kind)
        self.note(event.level, event.kind, event.sentence)
        values = dict(event.values) if event.stamp is None else {**event.values, STAMP: event.stamp}
        self._events.publish(event.level, event.kind, event.sentence, values)

    def announce(self, level: str, kind: str, sentence: str) -> None:
        """Publish an event that is not counted here, and log it the first time."""
        self.say(level, kind, sentence)
        self._events.publish(level, kind, sentence)

    def publish_events(self) -> None:
        """Publish the events of the control step since the last call; a jump of position or time names two sources."""
        while self._step.events:
            event = self._step.events.popleft()
            jumped = event.kind in CLOCK_JUMPS or event.sentence.startswith(f"stopped: {POSITION_JUMP}")
            found = self._node.get_publishers_info_by_topic(names.JOINT_STATES) if jumped else ()
            if len(found) > 1:
                event = replace(event, sentence=f"{event.sentence}; states come from {', '.join(map(node_of, found))}")
            self.event(event)

    def publish(self, wrong: str = "") -> None:
        """Publish the counters; the number of the control step is used for a kind that both count."""
        for kind, number in self._step.counters.items():
            self.count[kind] = max(number, self.count[kind])
        for name, seconds in self._step.seconds.items():
            self.value(f"seconds {name}", f"{seconds:.3f}")
        received, now = self.count[RECEIVED], time.monotonic()
        if received != self._heard[0] or self._step.owner is None:  # as of a node that is not active
            self._heard = received, now
        silent = now - self._heard[1]
        wrong = f"no states for {silent:.0f} s" if silent > self._step.settings.state_timeout else wrong
        self.value("state", wrong or self._step.state.value)
        super().publish(wrong)
