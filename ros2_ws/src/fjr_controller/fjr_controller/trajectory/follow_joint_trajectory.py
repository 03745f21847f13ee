# SPDX-License-Identifier: Apache-2.0
"""The action ~/follow_joint_trajectory, by the rules of ros2_control's joint_trajectory_controller.

A goal that cannot be tracked is rejected. An accepted goal ends when it is reached, a tolerance is violated, the
controller stops, another motion replaces it, or it is cancelled. Unless another motion replaces it, the arm then
holds its position; after a stop it does so from ~/resume on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future

from fjr_msgs_py import names
from fjr_msgs_py.messages.follow_joint_trajectory import FollowMessages, Progress
from fjr_msgs_py.messages.joint_states import JointSample

from ..tracking.events import State
from ..tracking.tracker import Command
from .goal_tolerances import Code, Goal, Outcome, Tolerances
from .interface import TrajectoryInterface
from .planner import Plan

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
        self._plan: Plan | None = None
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

    def on_command(self, sample: JointSample, command: Command, _arrival: int = 0, _sent: int = 0) -> None:
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
        at = Progress(sample.stamp, command.jets[0], command.jets[1], sample.q_l, command.velocity[:n])
        outcome = self._goal.check(at.stamp, at.q - at.q_d, at.dq - at.dq_d)
        if at.stamp - self._last_feedback >= FEEDBACK_PERIOD or outcome is not None:
            self._last_feedback = at.stamp
            self._handle.publish_feedback(self._messages.feedback(at))
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

        def on_done(plan: Plan | None) -> None:
            self._plan = plan or self._plan
            planned.set_result(plan)

        self._interface.follow(self._messages.trajectory(request), "another goal was accepted", on_done)
        plan = await planned
        return GoalResponse.ACCEPT if plan is not None and plan is self._plan else GoalResponse.REJECT

    def _on_accepted(self, handle: Any) -> None:
        assert self._plan is not None
        tolerances = self._tolerances.overridden(self._joints, *self._messages.tolerances(handle.request))
        self._goal = Goal(self._joints, self._plan.end, tolerances)
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
