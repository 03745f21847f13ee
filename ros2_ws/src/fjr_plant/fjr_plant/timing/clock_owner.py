# SPDX-License-Identifier: Apache-2.0
"""Own /clock in lock-step: with two publishers the time of all nodes would jump back and forth."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from fjr_core import FjrError
from fjr_msgs_py import names
from fjr_msgs_py.messages.clock import time_of
from fjr_msgs_py.node.conflicting_publishers import ConflictingPublishers
from fjr_msgs_py.node.diagnostics import Health

OTHERS = "other clocks"
LOOK_PERIOD = 0.5  # s between checks of the graph
SETTLING = 5.0  # s in which earlier publishers are discovered


class ClockError(FjrError):
    """Another process publishes the time."""


class ClockOwner:
    """Publisher of the time, unless another process publishes it.

    The topic is checked when the node starts, before the first command is accepted, and twice per second. An owner
    without a command so far that receives another time raises ClockError; it listens at every check while another
    publisher exists, because a busy one may be late. An owner with commands does so only while it is younger than
    SETTLING, and only if the other time is ahead of its own; later it continues and reports the other one.
    """

    def __init__(self, node: Node, health: Health, shown: Callable[[], int]) -> None:
        """shown: returns the time that was published last [ns]."""
        self._health, self._shown = health, shown
        self._conflicts = ConflictingPublishers(node, {names.CLOCK: Clock}, names.HISTORY)
        self._topic = node.resolve_topic_name(names.CLOCK)
        self._space = node.get_namespace().rstrip("/")
        (self.publisher,) = self._conflicts.publishers
        self._settled = time.monotonic() + SETTLING
        self._next_look = 0.0
        self.refuse_others()

    def refuse_others(self, ahead_of: int = 0) -> None:
        """Raise ClockError if another process publishes a time of at least `ahead_of` [ns] now."""
        self._conflicts.appeared()
        heard = self._conflicts.heard() if self._conflicts.others else None
        if heard and time_of(heard[1]) >= ahead_of:
            raise ClockError(self._sentence("publishes"))

    def look(self, established: bool) -> None:
        """Check twice per second for other publishers; raises ClockError unless established."""
        now = time.monotonic()
        if now < self._next_look:
            return
        self._next_look = now + LOOK_PERIOD
        if not established or now <= self._settled:
            self.refuse_others(ahead_of=self._shown() + 1 if established else 0)
        elif self._conflicts.appeared():
            self._health.error(OTHERS, self._sentence("has begun to publish"))

    def close(self) -> None:
        """Destroy the subscription, which the node does not know."""
        self._conflicts.trust()

    def _sentence(self, acts: str) -> str:
        own = f"{self._space or '/NAMESPACE'}/clock"
        return (
            f"{self._conflicts.named(self._topic)} {acts} on {self._topic}; expected one owner of the time: start this "
            f"plant and its controller with -r {names.CLOCK}:={own}"
        )
