# SPDX-License-Identifier: Apache-2.0
"""The controller that a node's parameters describe: law, tracker and all that speaks ROS around them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.node import Node

from fjr_core import ParameterError, Reference, TrackingLaw
from fjr_core.config import builders
from fjr_core.config.builders import control_law, robust_action
from fjr_core.config.description import robot_name
from fjr_core.config.diagnosis import axes
from fjr_core.config.measurement import measurement, observer
from fjr_core.config.parameter import named
from fjr_core.config.reference import motion_limits
from fjr_core.config.safety import safety
from fjr_core.numerics.checks import Array
from fjr_core.trajectories.motion_limits import check_motion
from fjr_msgs_py.messages.events import EventWriter
from fjr_msgs_py.messages.follow_joint_trajectory import follow_messages
from fjr_msgs_py.messages.joint_states import StateReader

from .ros.certificate_publisher import Witness
from .ros.command_loop import Answering, RivalError
from .ros.diagnostics import Reports
from .tracking.tracker import Tracker
from .trajectory.follow_joint_trajectory import FollowAction
from .trajectory.goal_tolerances import Tolerances, tolerances
from .trajectory.interface import Motion


class Control:
    """Built from the checked values of a node's parameters; computes and sends nothing before `start`.

    Raises FjrError for values that do not go together. `refused` is called when another process turns out to
    command the robot, before anything was sent.
    """

    def __init__(
        self, node: Node, values: dict[str, Any], events: EventWriter, refused: Callable[[RivalError], None]
    ) -> None:
        self._values, joints = values, values["joints"]
        self._robot = robot = builders.robot(values)
        settings, allowed = safety(values, robot), tolerances(values, robot.units)
        reader = StateReader(joints, measurement(values, robot))
        self._law = control_law(values, robot)
        simulated = bool(node.get_parameter("use_sim_time").value)
        robust = robust_action(values, self._law)
        self.tracker = Tracker(self._law, self._built_in(), settings, observer(values, robot), simulated, robust)
        self.tracker.warm_up()
        # Nothing above is made on the node, nothing below is refused.
        self.reports = Reports(node, self.tracker, events, robot_name(values))
        self._answering = Answering(node, joints, self.tracker, reader, self.reports, refused)
        self._motion = Motion(node, joints, self.tracker, self.reports, self._is_active, self._built_in)
        self._limit_motion()
        self._action = self._offered(node, allowed)
        self._witness = self._heard(node, np.asarray(settings.effort))

    def start(self) -> None:
        """Answer from the next state on, as at birth, with the reference that the parameters describe.

        Raises ParameterError where that leaves its limits, RivalError where another process commands the robot.
        """
        self.tracker.start(self._built_in())
        self._answering.start(self._values["state_timeout"])

    def stop(self) -> None:
        """Send the last command, where one is due, and the counters; answer no more."""
        self._motion.drop()
        self._motion.replaced("the controller was deactivated")
        self._answering.stop()
        self.reports.publish()

    def close(self) -> None:
        """Stop, and give everything back."""
        self.stop()
        self.withdraw()
        for part in (self._motion, self._answering, self.reports, self._witness):
            if part is not None:
                part.close()

    def withdraw(self) -> None:
        """Offer the action no more."""
        if self._action is not None:
            self._action.close()
            self._action = None

    def change(self, values: dict[str, Any], changed: set[str]) -> None:
        """Take over gains, limits and the built-in reference, from the next state on; all or, by FjrError, none."""
        robot, groups = self._robot, {name.split(".", 1)[0] for name in changed}
        settings = safety(values, robot)
        motion_limits(values, robot)
        builders.reference(values, robot.n)
        if "gains" in groups:
            if not isinstance(self._law, TrackingLaw):
                raise ParameterError(f"parameters 'gains.*' are of the law v_dpbc; the law is {values['law.type']}")
            law = self._law.with_gains(builders.gains(values, robot.n))
            self.tracker.use(law)
            self._law = law
        self._values = values
        if groups - {"gains", "reference"}:
            self.tracker.settings(settings)
            self._limit_motion()
        if self._witness is not None and isinstance(self._law, TrackingLaw):
            self._witness.use(self._law, np.asarray(settings.effort))
        self.reports.empty()

    def _is_active(self) -> bool:
        return self._answering.active

    def _built_in(self) -> Reference:
        """The reference that the parameters describe; raises ParameterError where it leaves its limits."""
        reference = builders.reference(self._values, self._robot.n)
        limits = motion_limits(self._values, self._robot)
        named(lambda _: "reference.*", lambda: check_motion(reference, limits, joints=self._values["joints"]))
        return reference

    def _limit_motion(self) -> None:
        values = self._values
        limits = motion_limits(values, self._robot)
        self._motion.limit(limits, values["recovery.join_time"], values["allow_partial_joints"])

    def _heard(self, node: Node, limit: Array) -> Witness | None:
        """The witness of all answers, where one is wanted and the law has a certificate."""
        if not self._values["certificate"]:
            return None
        if not isinstance(self._law, TrackingLaw):
            node.get_logger().info(f"the law {self._values['law.type']} has no certificate: none is published")
            return None
        robust = builders.robust(self._values, self._robot.n)
        judged = axes(self._values, self._robot)
        witness = Witness(node, self._law, self.tracker, limit, robust, judged)
        self._answering.tell(witness.see)
        self.reports.besides(witness.status)
        return witness

    def _offered(self, node: Node, allowed: Tolerances) -> FollowAction | None:
        """The action, where its messages are installed."""
        joints = self._values["joints"]
        messages = follow_messages(joints)
        if messages is None:
            return None
        action = FollowAction(node, joints, self._motion, allowed, messages)
        self._answering.tell(action.watch)
        return action
