# SPDX-License-Identifier: Apache-2.0
"""Assemble the controller from the parameters of its node: law, control step, topics, services and action."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.node import Node

from fjr_core import ParameterError, Reference, TrackingLaw
from fjr_core.config import law
from fjr_core.config.controller import effort_limits, measurement, motion_limits, observer, safety
from fjr_core.config.law import control_law, robust_action
from fjr_core.config.law import gains as build_gains
from fjr_core.config.law import robust as build_robust
from fjr_core.config.motion_warnings import file_warnings
from fjr_core.config.parameter import in_python, named
from fjr_core.config.reference import FILE_PATH, forget_files
from fjr_core.config.reference import reference as build_reference
from fjr_core.config.robot import robot as build_robot
from fjr_core.config.robot import robot_name
from fjr_core.motions.motion_limits import check_motion
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.safety_settings import Settings
from fjr_monitor.diagnosis.online_diagnosis import EffortLimits
from fjr_monitor.diagnosis.thresholds import JointTolerances
from fjr_msgs_py.messages.trajectories import follow_messages
from fjr_msgs_py.node.reports import EventWriter

from .certificate import LiveCertificate
from .command_loop import CommandConflictError, CommandLoop
from .follow_action import FollowAction, Tolerances, tolerances
from .reports import Reports
from .trajectory_interface import TrajectoryInterface


class Control:
    """The controller for the checked values of a node's parameters; it computes and sends nothing before `start`.

    Raises FjrError for values that contradict each other. `on_conflict` is called if another process turns out to
    command the robot before the first command was sent.
    """

    def __init__(
        self,
        node: Node,
        values: dict[str, Any],
        events: EventWriter,
        on_conflict: Callable[[CommandConflictError], None],
    ) -> None:
        self._values, joints = values, values["joints"]
        self._robot = robot = build_robot(values)
        forget_files()
        if values[FILE_PATH.name]:  # read now, so that a change of reference.type need not
            for sentence in file_warnings(values, robot):
                node.get_logger().warning(sentence)
        self._settings = settings = safety(values, robot)
        allowed = tolerances(values, robot.units)
        measured = measurement(values, robot)
        self._law = control_law(values, robot)
        if sentence := in_python(law.TYPE, values):
            node.get_logger().info(sentence)
        simulated = bool(node.get_parameter("use_sim_time").value)
        robust = robust_action(values, self._law)
        given = self._law, self._built_in(), settings, observer(values, robot), simulated, robust, measured
        self.step = ControlStep(*given)
        # Above nothing is created on the node; below nothing raises.
        self.reports = Reports(node, self.step, events, robot_name(values))
        self._command_loop = CommandLoop(node, self.step, measured, self.reports, on_conflict)
        apart = self._command_loop.native and not simulated
        self._interface = TrajectoryInterface(
            node, joints, self.step, self.reports, lambda: self._command_loop.active, self._built_in, apart
        )
        self._apply_motion_limits()
        self._action = self._create_action(node, allowed)
        self._certificate = self._create_certificate(node)

    def start(self, since: float) -> None:
        """Start tracking at the first state from `since` [s, steady clock] on, with the reference of the parameters.

        Raise ParameterError if the reference violates its limits.
        Raise CommandConflictError if another process commands the robot.
        """
        self.step.start(self._built_in())
        self._command_loop.start(self._values["state_timeout"], round(since * 1e9))

    def stop(self) -> None:
        """Send the stop effort if a command was sent before, publish the counters, and end the command loop."""
        self._interface.planner.drop()
        self._interface.on_replaced("the controller was deactivated")
        self._command_loop.stop()
        self.reports.publish()

    def close(self) -> None:
        """Stop, and destroy everything that was created on the node."""
        self.stop()
        self.destroy()

    def destroy(self) -> None:
        """Destroy everything that was created on the node, without a last effort."""
        for part in (self._action, self._interface, self._command_loop, self.reports, self._certificate):
            if part is not None:
                part.close()

    def change(self, values: dict[str, Any], changed: set[str]) -> None:
        """Apply gains, limits and the built-in reference from the next state on; on a FjrError change nothing."""
        robot, groups = self._robot, {name.split(".", 1)[0] for name in changed}
        settings = safety(values, robot)
        motion_limits(settings, robot)
        build_reference(values, robot.n)
        self._check_weight(settings)
        if "gains" in groups:
            if not isinstance(self._law, TrackingLaw):
                raise ParameterError(f"parameters 'gains.*' are of the law v_dpbc; the law is {values['law.type']}")
            law = self._law.with_gains(build_gains(values, robot.n))
            self.step.use(law)
            self._law = law
        self._values, self._settings = values, settings
        if groups - {"gains", "reference"}:
            self.step.apply(settings)
            self._apply_motion_limits()
        if self._certificate is not None and isinstance(self._law, TrackingLaw):
            self._certificate.use(self._law, self._effort_limits)
        self.reports.publish_events()

    def _check_weight(self, settings: Settings) -> None:
        """Raise ParameterError if an active controller gets a smaller limit of the effort below the weight it holds."""
        jets = self.step.jets_at(self.step.last_stamp or 0) if self._command_loop.active else None
        if jets is None:  # no sample yet
            return
        for q in self.step.measured[: self._robot.n], jets[0]:
            weight = np.abs(np.linalg.solve(self._robot.B_m, self._robot.grad_P_l(q)))
            for i in np.flatnonzero(settings.effort < np.minimum(weight, self._settings.effort)):
                unit, limit = settings.units[i].effort, np.asarray(settings.effort)[i]
                found = f"'limits.effort' of {settings.joints[i]} is {limit:g} {unit}; expected at least its weight"
                raise ParameterError(f"parameter {found}, {weight[i]:.3g} {unit}, while the controller is active")

    def _built_in(self) -> Reference:
        """Return the reference that the parameters describe. Raise ParameterError if it violates its limits."""
        reference = build_reference(self._values, self._robot.n)
        limits = motion_limits(self._settings, self._robot)
        named(lambda _: "reference.*", lambda: check_motion(reference, limits, joints=self._values["joints"]))
        return reference

    def _apply_motion_limits(self) -> None:
        values, limits = self._values, motion_limits(self._settings, self._robot)
        self._interface.apply(limits, values["recovery.join_time"], values["allow_partial_joints"])

    @property
    def _effort_limits(self) -> EffortLimits:
        """The largest effort and its largest rate."""
        return effort_limits(self._values, self._robot), np.asarray(self._settings.effort_rate)

    def _create_certificate(self, node: Node) -> LiveCertificate | None:
        """Return the certificate, if it is enabled and the law has a certificate."""
        if not self._values["certificate"]:
            return None
        if not isinstance(self._law, TrackingLaw):
            node.get_logger().info(f"the law {self._values['law.type']} has no certificate: none is published")
            return None
        robust, joint_axes = build_robust(self._values, self._robot.n), JointTolerances.of(self._values, self._robot)
        given = self._law, self.step.library, self._effort_limits, robust, joint_axes
        certificate = LiveCertificate(node, self._command_loop.program, *given)
        self._command_loop.certify(certificate)
        self.reports.add_status(certificate.status)
        return certificate

    def _create_action(self, node: Node, allowed: Tolerances) -> FollowAction | None:
        """Return the action server, or None if its messages are not installed."""
        messages = follow_messages(self._values["joints"])
        if messages is None:
            return None
        action = FollowAction(node, self._interface, allowed, messages, self._command_loop.read)
        self._command_loop.add_listener(action.on_command, lambda: action.has_goal)
        return action
