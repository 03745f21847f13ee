# SPDX-License-Identifier: Apache-2.0
"""The action ~/follow_joint_trajectory, by the rules of ros2_control's joint_trajectory_controller.

A goal that cannot be tracked is rejected. An accepted goal ends when it is reached, a tolerance is violated, the
controller stops, the stamps jump back, another motion replaces it, or it is cancelled. Unless another motion replaces
it, the arm then holds its position; after a stop it does so from ~/resume on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future

from fjr_core.config.parameter import vector
from fjr_core.model.joints import JointSample, Units
from fjr_core.numerics.checks import Array
from fjr_core.runtime.control_step import Command
from fjr_core.runtime.events import State
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
    """Largest errors of position [rad] and velocity [rad/s], (2, n), on the path and at the goal; 0: no limit.

    goal_time [s]: time after the last point within which the goal must be reached; 0: no limit.
    """

    joints: tuple[str, ...]
    units: tuple[Units, ...]
    path: Array
    goal: Array
    goal_time: float

    def overridden(self, path: Iterable[Any], goal: Iterable[Any], goal_time: float) -> Tolerances:
        """Return these tolerances with those that a goal requests; unknown joints are ignored.

        path, goal: control_msgs/JointTolerance, in which 0 keeps a tolerance and a negative number removes it.
        """
        on_path, at_goal = self.path.copy(), self.goal.copy()
        for largest, entries in ((on_path, path), (at_goal, goal)):
            for entry in entries:
                if entry.name in self.joints:
                    j = self.joints.index(entry.name)
                    for kind, asked in enumerate((entry.position, entry.velocity)):
                        largest[kind, j] = _override(asked, largest[kind, j])
        return replace(self, path=on_path, goal=at_goal, goal_time=_override(goal_time, self.goal_time))

    def outcome(self, late: float, errors: Array) -> Outcome | None:
        """Return the outcome of a goal, None while it is active.

        late [ns]: time since its last point; errors (2, n): of position and velocity.
        """
        if late < 0:
            violation = self._violation(errors, self.path)
            return Outcome(Code.PATH_TOLERANCE_VIOLATED, f"on the path, {violation}") if violation else None
        violation = self._violation(errors, self.goal)
        if not violation:
            return Outcome(Code.SUCCESSFUL, "the goal is reached")
        if self.goal_time and late > self.goal_time * 1e9:
            return Outcome(Code.GOAL_TOLERANCE_VIOLATED, f"{self.goal_time:g} s after the last point, {violation}")
        return None

    def _violation(self, errors: Array, largest: Array) -> str:
        """Describe the violated tolerance (2, n), of position before velocity; return "" if none is violated."""
        over = np.argwhere((largest > 0) & ~(np.abs(errors) <= largest))
        if not len(over):
            return ""
        kind, j = over[0]
        unit = getattr(self.units[j], ("position", "velocity")[kind])
        return f"{self.joints[j]} is off by {errors[kind, j]:.3g} {unit}; expected at most {largest[kind, j]:g}"


def tolerances(values: Mapping[str, Any], units: tuple[Units, ...]) -> Tolerances:
    """Return the tolerances of the parameters constraints.* for joints with these units (n,)."""
    n = len(units)
    path, goal = (vector(values, f"constraints.{name}", n) for name in ("trajectory", "goal"))
    stopped = np.full(n, values["constraints.stopped_velocity_tolerance"])
    limits = np.stack([path, np.zeros(n)]), np.stack([goal, stopped])
    return Tolerances(tuple(values["joints"]), units, *limits, values["constraints.goal_time"])


def _override(value: float, default: float) -> float:
    return default if value == 0 else max(float(value), 0.0)


FEEDBACK_PERIOD = 50_000_000  # ns, as in joint_trajectory_controller


class FollowAction:
    """An action server with at most one goal at a time; `on_command` checks it at every sample."""

    def __init__(
        self,
        node: Node,
        interface: TrajectoryInterface,
        tolerances: Tolerances,
        messages: FollowMessages,
        read: Callable[[], None],
    ) -> None:
        """read: calls `on_command` for all samples that were answered so far."""
        self._node, self._interface, self._read = node, interface, read
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
        desired, actual = command.jets[:2], np.stack([sample.q_l, command.velocity[: len(sample.q_l)]])
        outcome = self._outcome(command, sample.stamp - self._end_of_goal, actual - desired)
        if sample.stamp - self._last_feedback >= FEEDBACK_PERIOD or outcome is not None:
            self._last_feedback = sample.stamp
            self._handle.publish_feedback(self._messages.feedback(sample.stamp, desired, actual))
        if outcome is not None:
            if outcome.code is not Code.SUCCESSFUL:
                self._interface.hold()  # neither ~/resume nor another time line must continue the trajectory
            self._end(outcome)

    def _outcome(self, command: Command, late: float, errors: Array) -> Outcome | None:
        if self._handle.is_cancel_requested:
            return Outcome(Code.SUCCESSFUL, "cancelled")
        if command.restarted or command.state is State.STOPPED:
            why = "the time of the states jumped back" if command.restarted else "the controller has stopped"
            return Outcome(Code.PATH_TOLERANCE_VIOLATED, why)
        return self._goal.outcome(late, errors)

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
        self._goal = self._tolerances.overridden(*self._messages.tolerances(handle.request))
        self._end_of_goal = self._plan.end
        self._read()  # samples of before are not judged by this goal
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
