# SPDX-License-Identifier: Apache-2.0
"""JointTrajectory and FollowJointTrajectory <-> NumPy, by the conventions of the joint_trajectory_controller.

As there: joints may come in any order; some may be missing if that is allowed, and these hold; header.stamp zero
means now; times increase strictly; every point has positions and may have velocities and accelerations. Efforts, a
nonzero last velocity and a trajectory in the past are rejected.
Unlike there: a message without points is a stop, as in ROS 1; no parameter allows a nonzero last velocity. Duplicate
joints, numbers that are not finite, accelerations without velocities, and velocities or accelerations of only some
points are rejected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fjr_core.numerics.checks import Array

from .joint_states import SECOND, MessageError, nanoseconds, set_nanoseconds


@dataclass(frozen=True, eq=False)
class TrajectoryPoints:
    """Waypoints of a trajectory of n joints; k = 0 points is a stop.

    start: stamp [ns] at which time is zero, or None for now. times (k,) [ns], increasing.
    positions (k, n) [rad]; velocities [rad/s] and accelerations [rad/s^2] (k, n), or None if not given.
    moves (n,): True for joints of the trajectory; the columns of other joints are NaN until `completed`.
    """

    start: int | None
    times: NDArray[np.int64]
    positions: Array
    velocities: Array | None
    accelerations: Array | None
    moves: NDArray[np.bool_]

    def upcoming(self, now: int) -> TrajectoryPoints:
        """Return the waypoints that lie after `now` [ns], with a start that is not before `now`.

        Raises MessageError if no waypoint is left.
        """
        start = now if self.start is None else self.start
        begin = max(start, now)
        left = self.times > begin - start
        if not left.any():
            raise MessageError("in the past", self._late(start, now))
        rows: dict[str, Any] = {name: each[left] for name, each in self._derivatives().items()}
        times, positions = self.times[left] - (begin - start), self.positions[left]
        return replace(self, start=begin, times=times, positions=positions, **rows)

    def _late(self, start: int, now: int) -> str:
        if self.start is None:
            return f"the last point is at {self.times[-1] / SECOND:g} s; expected a time after the start"
        behind = (now - start - int(self.times[-1])) / SECOND
        return f"the last point is {behind:g} s before the newest state's stamp; expected one after it"

    def completed(self, position: Array) -> TrajectoryPoints:
        """Return waypoints of all joints; joints that are not part of the trajectory rest at `position` (n,) [rad]."""
        if self.moves.all():
            return self
        rows: dict[str, Any] = {name: np.where(self.moves, each, 0.0) for name, each in self._derivatives().items()}
        return replace(self, positions=np.where(self.moves, self.positions, position), **rows)

    def _derivatives(self) -> dict[str, Array]:
        """Return velocities and accelerations (k, n) by name, as far as they are given."""
        given = {"velocities": self.velocities, "accelerations": self.accelerations}
        return {name: rows for name, rows in given.items() if rows is not None}


def trajectory_message(
    joints: Sequence[str], times: Array, positions: Array, velocities: Array, accelerations: Array
) -> JointTrajectory:
    """Return a message that starts now, from times (k,) [s] and rows (k, n) in the order of the joints."""
    message = JointTrajectory(joint_names=list(joints))
    for t, q, dq, ddq in zip(times, positions, velocities, accelerations, strict=True):
        point = JointTrajectoryPoint(positions=q.tolist(), velocities=dq.tolist(), accelerations=ddq.tolist())
        set_nanoseconds(point.time_from_start, round(t * SECOND))
        message.points.append(point)
    return message


def read_trajectory(message: JointTrajectory, joints: Sequence[str], allow_partial: bool = False) -> TrajectoryPoints:
    """Return the waypoints of a message for the joints of a robot; raises MessageError if it is invalid.

    allow_partial: accept some of the joints.
    """
    stamp = nanoseconds(message.header.stamp)
    if stamp < 0:
        raise MessageError("bad times", f"header.stamp is {stamp} ns; expected zero, for now, or a time")
    names, n, points = list(message.joint_names), len(joints), message.points
    if not points:
        return TrajectoryPoints(stamp or None, np.empty(0, np.int64), np.empty((0, n)), None, None, np.ones(n, bool))
    _check_names(names, list(joints), allow_partial)
    times = _times(points)
    for i, point in enumerate(points):
        if len(point.effort):
            raise MessageError("efforts", f"point {i} has efforts; expected positions, velocities and accelerations")
    given = ["positions", *(field for field in ("velocities", "accelerations") if _is_given(points, field))]
    rows = {field: _rows(points, field, names) for field in given}
    if "velocities" in given:
        _stop_at_end(rows["velocities"], names)
    elif "accelerations" in given:
        raise MessageError("wrong lengths", "the points have accelerations without velocities; expected both")
    spread = {field: np.full((len(points), n), np.nan) for field in given}
    for field, values in rows.items():
        spread[field][:, [list(joints).index(name) for name in names]] = values
    velocities, accelerations = spread.get("velocities"), spread.get("accelerations")
    moves = np.isin(joints, names)
    return TrajectoryPoints(stamp or None, times, spread["positions"], velocities, accelerations, moves)


def _check_names(names: list[str], joints: list[str], allow_partial: bool) -> None:
    unknown = [name for name in names if name not in joints]
    if unknown or not names:
        raise MessageError("unknown joints", f"joint_names are {names}; expected some of {joints}")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise MessageError("duplicate joints", f"joint_names are {names}; expected {twice} only once")
    missing = [name for name in joints if name not in names]
    if missing and not allow_partial:
        raise MessageError(
            "partial joints",
            f"joint_names are {names}; expected {missing} too, or the parameter allow_partial_joints",
        )


def _is_given(points: Sequence[JointTrajectoryPoint], field: str) -> bool:
    """Return whether the points have a field; raise MessageError if only some of them do."""
    given = [bool(len(getattr(point, field))) for point in points]
    if any(given) and not all(given):
        i = given.index(False)
        raise MessageError("wrong lengths", f"point {i} has no {field}, others have; expected all or none")
    return any(given)


def _times(points: Sequence[JointTrajectoryPoint]) -> NDArray[np.int64]:
    times = np.array([nanoseconds(point.time_from_start) for point in points])
    if times[0] < 0:
        raise MessageError("bad times", f"point 0 is at {times[0] / SECOND:g} s; expected at least 0 s")
    back = np.flatnonzero(np.diff(times) <= 0)
    if back.size:
        i = int(back[0]) + 1
        raise MessageError(
            "bad times",
            f"point {i} is at {times[i] / SECOND:g} s; expected it after point {i - 1}, {times[i - 1] / SECOND:g} s",
        )
    return times


def _stop_at_end(velocities: Array, names: list[str]) -> None:
    """Set the last row (m,) to zero if it is zero in single precision; raise MessageError otherwise."""
    moving = np.flatnonzero(np.abs(velocities[-1]) > np.finfo(np.float32).eps)
    if moving.size:
        k, j = len(velocities) - 1, int(moving[0])
        raise MessageError(
            "moving end", f"the last point, {k}, gives {names[j]} a velocity of {velocities[k, j]:g}; expected 0"
        )
    velocities[-1] = 0.0


def _rows(points: Sequence[JointTrajectoryPoint], field: str, names: list[str]) -> Array:
    """Return a field of all points as (k, m); raises MessageError for a wrong length or a number that is not finite."""
    for i, point in enumerate(points):
        size = len(getattr(point, field))
        if size != len(names):
            raise MessageError(
                "wrong lengths", f"point {i} has {size} {field}; expected {len(names)}, one per joint name"
            )
    rows = np.array([getattr(point, field) for point in points], dtype=float)
    bad = np.argwhere(~np.isfinite(rows))
    if bad.size:
        i, j = bad[0]
        raise MessageError(
            "not finite", f"{field} of point {i} hold {rows[i, j]} for {names[j]}; expected finite numbers"
        )
    return rows


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

    def feedback(self, stamp: int, desired: Array, actual: Array) -> Any:
        """Return the feedback at a stamp [ns], with error = desired - actual.

        desired, actual (2, n): positions [rad] and velocities [rad/s].
        """
        message = self.kind.Feedback(joint_names=self._joints)
        set_nanoseconds(message.header.stamp, stamp)
        rows = {"desired": desired, "actual": actual, "error": desired - actual}
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
