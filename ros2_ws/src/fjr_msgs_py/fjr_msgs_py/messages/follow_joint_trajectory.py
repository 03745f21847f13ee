# SPDX-License-Identifier: Apache-2.0
"""NumPy <-> control_msgs/action/FollowJointTrajectory, if control_msgs is installed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from trajectory_msgs.msg import JointTrajectory

from fjr_core.numerics.checks import Array


@dataclass(frozen=True, eq=False)
class Progress:
    """Progress of an action: stamp [ns], desired and actual positions [rad] and velocities [rad/s], each (n,)."""

    stamp: int
    q_d: Array
    dq_d: Array
    q: Array
    dq: Array


class FollowMessages:
    """Reader and writer of the messages of FollowJointTrajectory; `kind` is the type of the action."""

    def __init__(self, kind: Any, joints: Sequence[str]) -> None:
        self.kind = kind
        self._joints = list(joints)

    def trajectory(self, request: Any) -> JointTrajectory:
        """Return the trajectory of a goal."""
        return request.trajectory

    def tolerances(self, request: Any) -> tuple[Sequence[Any], Sequence[Any], float]:
        """Return path tolerances, goal tolerances and goal time tolerance [s] of a goal."""
        time = request.goal_time_tolerance
        return request.path_tolerance, request.goal_tolerance, time.sec + time.nanosec * 1e-9

    def result(self, code: int, sentence: str) -> Any:
        """Return the result with an error code and its reason."""
        return self.kind.Result(error_code=code, error_string=sentence)

    def feedback(self, progress: Progress) -> Any:
        """Return the feedback: desired, actual, and error = desired - actual."""
        message = self.kind.Feedback(joint_names=self._joints)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(progress.stamp, 1_000_000_000)
        rows = {
            "desired": (progress.q_d, progress.dq_d),
            "actual": (progress.q, progress.dq),
            "error": (progress.q_d - progress.q, progress.dq_d - progress.dq),
        }
        for name, (positions, velocities) in rows.items():
            point = getattr(message, name)
            point.positions, point.velocities = positions.tolist(), velocities.tolist()
        return message


def follow_messages(joints: Sequence[str]) -> FollowMessages | None:
    """Return the reader and writer, or None if control_msgs is not installed."""
    try:
        return FollowMessages(import_module("control_msgs.action").FollowJointTrajectory, joints)
    except ImportError:
        return None
