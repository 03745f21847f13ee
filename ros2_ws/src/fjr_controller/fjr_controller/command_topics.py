# SPDX-License-Identifier: Apache-2.0
"""The command topics: their publishers, and other processes that command the robot."""

from __future__ import annotations

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_core import FjrError
from fjr_core.runtime.events import Event
from fjr_msgs_py import names
from fjr_msgs_py.node.conflicting_publishers import ConflictingPublishers

from .reports import Reports

TOPICS = {names.EFFORT_COMMANDS: Float64MultiArray, names.JOINT_COMMANDS: JointState}
CONFLICTS = "other controllers"
ALONE = "expected nobody else to command the robot"
LOOK_PERIOD = 0.5  # s


class CommandConflictError(FjrError):
    """Another process publishes on a command topic."""


class CommandTopics(ConflictingPublishers):
    """The publishers of both command topics (efforts, commands), and the search for conflicting ones.

    The search takes place at the start, before the first command and every LOOK_PERIOD after it. A conflict before the
    first command is an error; a later one is reported.
    """

    def __init__(self, node: Node, reports: Reports) -> None:
        """Create the publishers; raise CommandConflictError if another process publishes on a command topic."""
        super().__init__(node, TOPICS, names.sample_qos(node))
        self._reports, self._alone = reports, False
        self._timer = node.create_timer(LOOK_PERIOD, self._look, clock=names.STEADY)
        try:
            self.check_alone()
        except CommandConflictError:
            self.close()
            raise

    def check_alone(self) -> None:
        """Raise CommandConflictError if a publisher that has appeared is not silent, as that of a killed node is."""
        heard = self.heard() if self.appeared() else None
        if heard:
            raise CommandConflictError(f"{self.named(heard[0])} publishes on {heard[0]}; {ALONE}")

    def end_search(self) -> None:
        """Destroy the subscriptions of the search, which the node does not know; from now on conflicts are reported."""
        self._alone = True
        self.trust()

    def close(self) -> None:
        """Destroy publishers, subscriptions and timer."""
        self._node.destroy_timer(self._timer)
        super().close()

    def _look(self) -> None:
        topics = self.appeared() if self._alone else ()
        if topics:
            named = self.named(*topics)
            sentence = f"{named} has begun to publish on {' and '.join(topics)}; {ALONE}"
            self._reports.event(Event("error", CONFLICTS, sentence, {"nodes": named}))
