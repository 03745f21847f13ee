# SPDX-License-Identifier: Apache-2.0
"""trajectory_msgs/JointTrajectory -> numpy, by the conventions of ros2_control's joint_trajectory_controller.

As there: joints in any order; a part of them only where that is allowed, and the others hold; header.stamp zero
means now; times strictly increase; every point has positions, and may have velocities and accelerations; efforts
and a last velocity that is not zero are refused, and so is a trajectory that is over.
Otherwise than there: a message without points is a stop, as it was in ROS 1, not an error; no parameter allows a last
velocity; a joint that is named twice, a number that is not finite, accelerations without velocities, and points of
which only some have them are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from .joint_states import MessageError, nanoseconds

Array = NDArray[np.float64]
SECOND = 1_000_000_000  # ns


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Where the joints are to be, and when.

    start: stamp [ns] from which the times count, or None for now. times (k,) [ns], increasing.
    positions (k, n) [rad]; velocities [rad/s] and accelerations [rad/s^2] (k, n), or None where none are given.
    moves (n,): whether a joint is part of it; the columns of the others are NaN until `completed`.
    Without points (k = 0) it is a stop.
    """

    start: int | None
    times: NDArray[np.int64]
    positions: Array
    velocities: Array | None
    accelerations: Array | None
    moves: NDArray[np.bool_]

    def upcoming(self, now: int) -> Waypoints:
        """The points that are still to be reached at `now` [ns], where they count from now if that is their start.

        The result has a start, not before `now`. Raises MessageError when no point is left.
        """
        start = now if self.start is None else self.start
        begin = max(start, now)
        left = self.times > begin - start
        if not left.any():
            raise MessageError("in the past", self._late(start, now))
        return replace(
            self,
            start=begin,
            times=self.times[left] - (begin - start),
            positions=self.positions[left],
            velocities=None if self.velocities is None else self.velocities[left],
            accelerations=None if self.accelerations is None else self.accelerations[left],
        )

    def _late(self, start: int, now: int) -> str:
        if self.start is None:
            return f"the last point is at {self.times[-1] / SECOND:g} s; expected a time after the start"
        behind = (now - start - int(self.times[-1])) / SECOND
        return f"the last point is {behind:g} s before the newest state's stamp; expected one after it"

    def completed(self, position: Array) -> Waypoints:
        """With every joint that is not part of it at rest at `position` (n,) [rad]."""
        if self.moves.all():
            return self
        return replace(
            self,
            positions=np.where(self.moves, self.positions, position),
            velocities=None if self.velocities is None else np.where(self.moves, self.velocities, 0.0),
            accelerations=None if self.accelerations is None else np.where(self.moves, self.accelerations, 0.0),
        )


class TrajectoryReader:
    """Reads JointTrajectories of the joints of a robot."""

    def __init__(self, joints: Sequence[str], allow_partial: bool = False) -> None:
        self._joints = list(joints)
        self._allow_partial = allow_partial

    def read(self, message: JointTrajectory) -> Waypoints:
        """What the message asks for; raises MessageError for what it cannot ask for."""
        stamp = nanoseconds(message.header.stamp)
        if stamp < 0:
            raise MessageError("bad times", f"header.stamp is {stamp} ns; expected zero, for now, or a time")
        names = list(message.joint_names)
        n, points = len(self._joints), message.points
        if not points:
            nothing = np.empty((0, n))
            return Waypoints(stamp or None, np.empty(0, np.int64), nothing, None, None, np.ones(n, bool))
        self._check_names(names)
        times = _times(points)
        _refuse_efforts(points)
        columns = np.array([self._joints.index(name) for name in names])
        positions = self._spread(_rows(points, "positions", names), columns)
        velocities = self._optional(points, "velocities", names, columns)
        accelerations = self._optional(points, "accelerations", names, columns)
        if velocities is None and accelerations is not None:
            raise MessageError("wrong lengths", "the points have accelerations without velocities; expected both")
        moves = np.zeros(n, bool)
        moves[columns] = True
        return Waypoints(stamp or None, times, positions, velocities, accelerations, moves)

    def _check_names(self, names: list[str]) -> None:
        unknown = [name for name in names if name not in self._joints]
        if unknown or not names:
            raise MessageError("unknown joints", f"joint_names are {names}; expected some of {self._joints}")
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise MessageError("duplicate joints", f"joint_names are {names}; expected {twice} only once")
        missing = [name for name in self._joints if name not in names]
        if missing and not self._allow_partial:
            raise MessageError(
                "partial joints",
                f"joint_names are {names}; expected {missing} too, or the parameter allow_partial_joints",
            )

    def _optional(
        self, points: Sequence[JointTrajectoryPoint], field: str, names: list[str], columns: NDArray[np.int64]
    ) -> Array | None:
        given = [bool(len(getattr(point, field))) for point in points]
        if not any(given):
            return None
        if not all(given):
            i = given.index(False)
            raise MessageError("wrong lengths", f"point {i} has no {field}, others have; expected all or none")
        rows = _rows(points, field, names)
        if field == "velocities":
            _come_to_rest(rows, names)
        return self._spread(rows, columns)

    def _spread(self, rows: Array, columns: NDArray[np.int64]) -> Array:
        """Rows (k, m) in the message's order as (k, n) in the robot's, NaN where nothing is said."""
        spread = np.full((len(rows), len(self._joints)), np.nan)
        spread[:, columns] = rows
        return spread


def _times(points: Sequence[JointTrajectoryPoint]) -> NDArray[np.int64]:
    times = np.array([point.time_from_start.sec * SECOND + point.time_from_start.nanosec for point in points])
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


def _refuse_efforts(points: Sequence[JointTrajectoryPoint]) -> None:
    for i, point in enumerate(points):
        if len(point.effort):
            raise MessageError("efforts", f"point {i} has efforts; expected positions, velocities and accelerations")


def _come_to_rest(velocities: Array, names: list[str]) -> None:
    """Make the last row (m,) exactly zero, where single precision says that it is, or raise MessageError."""
    moving = np.flatnonzero(np.abs(velocities[-1]) > np.finfo(np.float32).eps)
    if moving.size:
        k, j = len(velocities) - 1, int(moving[0])
        raise MessageError(
            "moving end", f"the last point, {k}, gives {names[j]} a velocity of {velocities[k, j]:g}; expected 0"
        )
    velocities[-1] = 0.0


def _rows(points: Sequence[JointTrajectoryPoint], field: str, names: list[str]) -> Array:
    """A field of all points as (k, m)."""
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
