# SPDX-License-Identifier: Apache-2.0
"""The controller that a node's parameters describe: law, tracker and all that speaks ROS around them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from fjr_core import Reference, TrackingLaw, config
from fjr_core.measurement_parameters import measurement, observer
from fjr_core.motion_parameters import motion_limits
from fjr_core.safety_parameters import safety
from fjr_msgs_py.follow_messages import follow_messages
from fjr_msgs_py.messages import StateReader

from .answering import Answering, RivalError
from .follow_action import FollowAction
from .goals import tolerances
from .motion import Motion
from .reports import Reports
from .tracker import Tracker


class Control:
    """Built from the checked values of a node's parameters; computes and sends nothing before `start`.

    Raises FjrError for values that do not go together. `refused` is called when another process turns out to
    command the robot, before anything was sent.
    """

    def __init__(self, node: Node, values: dict[str, Any], refused: Callable[[RivalError], None]) -> None:
        self._values, joints = values, values["joints"]
        self._robot = robot = config.robot(values)
        settings, limits = safety(values, robot), motion_limits(values, robot)
        reader = StateReader(joints, measurement(values, robot))
        self._law = TrackingLaw(robot, config.gains(values, robot.n), compile=values["compile"])
        reference, simulated = config.reference(values, robot.n), bool(node.get_parameter("use_sim_time").value)
        self.tracker = Tracker(self._law, reference, settings, observer(values, robot), simulated)
        self.tracker.warm_up()
        self.reports = Reports(node, self.tracker)
        self._answering = Answering(node, joints, self.tracker, reader, self.reports, refused)
        self._motion = Motion(node, joints, self.tracker, self.reports, self._is_active, self._built_in)
        self._motion.limit(limits, values["allow_partial_joints"])
        self._action = self._offered(node)

    def start(self) -> None:
        """Answer from the next state on; raises RivalError where another process commands the robot."""
        self._answering.start(self._values["state_timeout"])

    def stop(self) -> None:
        """Send the last command, where one is due, and the counters; answer no more."""
        self._motion.replaced("the controller was deactivated")
        self._answering.stop()
        self.reports.publish()

    def close(self) -> None:
        """Stop, and give everything back."""
        self.stop()
        self.withdraw()
        for part in (self._motion, self._answering, self.reports):
            part.close()

    def withdraw(self) -> None:
        """Offer the action no more."""
        if self._action is not None:
            self._action.close()
            self._action = None

    def change(self, values: dict[str, Any], changed: set[str]) -> None:
        """Take over gains, limits and the built-in reference, from the next state on; all or, by FjrError, none."""
        robot, groups = self._robot, {name.split(".", 1)[0] for name in changed}
        settings, limits = safety(values, robot), motion_limits(values, robot)
        config.reference(values, robot.n)
        if "gains" in groups:
            self._law = self._law.with_gains(config.gains(values, robot.n))
            self.tracker.use(self._law)
        if groups - {"gains", "reference"}:
            self.tracker.settings(settings)
            self._motion.limit(limits, values["allow_partial_joints"])
        self._values = values
        self.reports.empty()

    def _is_active(self) -> bool:
        return self._answering.active

    def _built_in(self) -> Reference:
        return config.reference(self._values, self._robot.n)

    def _offered(self, node: Node) -> FollowAction | None:
        """The action, where its messages are installed."""
        joints = self._values["joints"]
        messages = follow_messages(joints)
        if messages is None:
            return None
        action = FollowAction(node, joints, self._motion, tolerances(self._values, len(joints)), messages)
        self._answering.tell(action.watch)
        return action
