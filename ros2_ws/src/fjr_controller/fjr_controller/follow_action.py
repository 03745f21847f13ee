# SPDX-License-Identifier: Apache-2.0
"""The action ~/follow_joint_trajectory, by the rules of ros2_control's joint_trajectory_controller.

A goal that cannot be tracked is rejected. An accepted goal ends when it is reached, a tolerance is violated, the
controller stops, another motion replaces it, or it is cancelled. Unless another motion replaces it, the arm then
holds its position; after a stop it does so from ~/resume on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future

from fjr_core.config.parameter import vector
from fjr_core.model.robot import Units
from fjr_core.numerics.checks import Array
from fjr_core.runtime.control_step import Command
from fjr_core.runtime.events import State
from fjr_core.runtime.measurement_model import JointSample
from fjr_msgs_py import names
from fjr_msgs_py.messages.trajectories import FollowMessages

from .planner import TrajectoryPlan
from .trajectory_interface import TrajectoryInterface


class Code(IntEnum):
    """Result codes of control_msgs/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


@dataclass(frozen=True)
class Outcome:
    """Result of a goal: a code and a sentence."""

    code: Code
    sentence: str


@dataclass(frozen=True, eq=False)
class Tolerances:
    """Largest errors of position [rad] and velocity [rad/s], on the path and at the goal, each (n,); 0: no limit.

    goal_time [s]: time after the last point within which the goal must be reached; 0: no limit. units: of each joint.
    """

    path: Array
    path_velocity: Array
    goal: Array
    goal_velocity: Array
    goal_time: float
    units: tuple[Units, ...]

    def overridden(
        self,
        joints: Sequence[str],
        path: Iterable[Any],
        goal: Iterable[Any],
        goal_time: float,
    ) -> Tolerances:
        """Return these tolerances with those that a goal requests; unknown joints are ignored.

        path, goal: control_msgs/JointTolerance, in which 0 keeps a tolerance and a negative number removes it.
        """
        new = {name: getattr(self, name).copy() for name in ("path", "path_velocity", "goal", "goal_velocity")}
        for where, entries in (("path", path), ("goal", goal)):
            for entry in entries:
                if entry.name in joints:
                    j = joints.index(entry.name)
                    new[where][j] = _override(entry.position, new[where][j])
                    new[f"{where}_velocity"][j] = _override(entry.velocity, new[f"{where}_velocity"][j])
        return replace(self, **new, goal_time=_override(goal_time, self.goal_time))


def tolerances(values: Mapping[str, Any], units: tuple[Units, ...]) -> Tolerances:
    """Return the tolerances of the parameters constraints.* for joints with these units (n,)."""
    n = len(units)
    path, goal = (vector(values, f"constraints.{name}", n) for name in ("trajectory", "goal"))
    stopped = np.full(n, values["constraints.stopped_velocity_tolerance"])
    return Tolerances(path, np.zeros(n), goal, stopped, values["constraints.goal_time"], units)


@dataclass(frozen=True, eq=False)
class TrackedGoal:
    """A trajectory to be tracked until the stamp `end` [ns], within tolerances."""

    joints: tuple[str, ...]
    end: float
    tolerances: Tolerances

    def check(self, stamp: int, q_tilde_l: Array, dq_tilde_l: Array) -> Outcome | None:
        """Return the outcome for errors (n,) [rad], [rad/s] at the stamp [ns]; None while the goal is active."""
        t = self.tolerances
        if stamp < self.end:
            violation = self._violation(q_tilde_l, dq_tilde_l, t.path, t.path_velocity)
            return Outcome(Code.PATH_TOLERANCE_VIOLATED, f"on the path, {violation}") if violation else None
        violation = self._violation(q_tilde_l, dq_tilde_l, t.goal, t.goal_velocity)
        if not violation:
            return Outcome(Code.SUCCESSFUL, "the goal is reached")
        if t.goal_time and stamp - self.end > t.goal_time * 1e9:
            return Outcome(Code.GOAL_TOLERANCE_VIOLATED, f"{t.goal_time:g} s after the last point, {violation}")
        return None

    def _violation(self, q_tilde_l: Array, dq_tilde_l: Array, position: Array, velocity: Array) -> str:
        """Describe the violated tolerance (n,), of position before velocity; return "" if none is violated."""
        for quantity, errors, largest in (("position", q_tilde_l, position), ("velocity", dq_tilde_l, velocity)):
            over = np.flatnonzero((largest > 0) & ~(np.abs(errors) <= largest))
            if over.size:
                j = int(over[0])
                unit = getattr(self.tolerances.units[j], quantity)
                return f"{self.joints[j]} is off by {errors[j]:.3g} {unit}; expected at most {largest[j]:g}"
        return ""


def _override(value: float, default: float) -> float:
    return default if value == 0 else max(float(value), 0.0)


FEEDBACK_PERIOD = 50_000_000  # ns, as in joint_trajectory_controller


class FollowAction:
    """An action server with at most one goal at a time; `on_command` checks it at every sample."""

    def __init__(
        self,
        node: Node,
        joints: Sequence[str],
        interface: TrajectoryInterface,
        tolerances: Tolerances,
        messages: FollowMessages,
    ) -> None:
        self._node, self._joints, self._interface = node, tuple(joints), interface
        self._tolerances, self._messages = tolerances, messages
        self._plan: TrajectoryPlan | None = None
        self._handle: Any = None
        self._last_feedback = 0  # stamp, ns
        interface.on_replaced = self._on_replaced
        self._server = ActionServer(
            node,
            messages.kind,
            names.FOLLOW_JOINT_TRAJECTORY,
            execute_callback=lambda handle: None,  # each goal executes its own callback when it ends
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
            callback_group=ReentrantCallbackGroup(),  # samples are handled while a goal is planned
        )

    def on_command(self, sample: JointSample, command: Command) -> None:
        """Check the active goal at a sample and its command; publish feedback every FEEDBACK_PERIOD."""
        if self._handle is None:
            return
        if self._handle.is_cancel_requested:
            self._end(Outcome(Code.SUCCESSFUL, "cancelled"))
            return
        if command.state is State.STOPPED:
            self._interface.hold()  # ~/resume must not continue the trajectory
            self._end(Outcome(Code.PATH_TOLERANCE_VIOLATED, "the controller has stopped"))
            return
        n = len(self._joints)
        desired, actual = command.jets[:2], np.stack([sample.q_l, command.velocity[:n]])
        outcome = self._goal.check(sample.stamp, *(actual - desired))
        if sample.stamp - self._last_feedback >= FEEDBACK_PERIOD or outcome is not None:
            self._last_feedback = sample.stamp
            self._handle.publish_feedback(self._messages.feedback(sample.stamp, desired, actual))
        if outcome is not None:
            if outcome.code is not Code.SUCCESSFUL:
                self._interface.hold()
            self._end(outcome)

    @property
    def has_goal(self) -> bool:
        """True while a goal is active."""
        return self._handle is not None

    def close(self) -> None:
        """Destroy the action server."""
        self._server.destroy()

    async def _on_goal(self, request: Any) -> GoalResponse:
        """Accept the goal once it is planned; it is tracked from then on."""
        planned = Future()

        def on_done(plan: TrajectoryPlan | None) -> None:
            self._plan = plan or self._plan
            planned.set_result(plan)

        self._interface.follow(self._messages.trajectory(request), "another goal was accepted", on_done)
        plan = await planned
        return GoalResponse.ACCEPT if plan is not None and plan is self._plan else GoalResponse.REJECT

    def _on_accepted(self, handle: Any) -> None:
        assert self._plan is not None
        tolerances = self._tolerances.overridden(self._joints, *self._messages.tolerances(handle.request))
        self._goal = TrackedGoal(self._joints, self._plan.end, tolerances)
        self._handle, self._last_feedback = handle, 0

    def _on_cancel(self, handle: Any) -> CancelResponse:
        if handle == self._handle:
            self._interface.hold()
        return CancelResponse.ACCEPT

    def _on_replaced(self, reason: str) -> None:
        self._plan = None
        if self._handle is not None:
            self._end(Outcome(Code.INVALID_GOAL, f"aborted: {reason}"))

    def _end(self, outcome: Outcome) -> None:
        handle, self._handle = self._handle, None
        if self._node.executor is not None:  # without an executor no client waits
            handle.execute(lambda handle: self._conclude(handle, outcome))

    def _conclude(self, handle: Any, outcome: Outcome) -> Any:
        if handle.is_cancel_requested:
            handle.canceled()
        elif outcome.code is Code.SUCCESSFUL:
            handle.succeed()
        else:
            handle.abort()
        return self._messages.result(int(outcome.code), outcome.sentence)
