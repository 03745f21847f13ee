# SPDX-License-Identifier: Apache-2.0
"""When a goal of FollowJointTrajectory is reached or missed; without ROS.

The rules and the words' meaning are those of ros2_control's joint_trajectory_controller.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Protocol

import numpy as np

from fjr_core.config.parameter import vector
from fjr_core.numerics.checks import Array
from fjr_core.robot.joint_units import Units


class Code(IntEnum):
    """control_msgs/FollowJointTrajectory's result codes."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


@dataclass(frozen=True)
class Outcome:
    """How a goal ended, in a code and a sentence."""

    code: Code
    sentence: str


class JointTolerance(Protocol):
    """control_msgs/JointTolerance: 0 leaves a tolerance as it is, a negative number lifts it."""

    name: str
    position: float
    velocity: float


@dataclass(frozen=True, eq=False)
class Tolerances:
    """Largest errors: position [rad] and velocity [rad/s], on the path and at the goal, each (n,); 0 for any.

    goal_time [s]: how long after the last point the goal may still be reached, 0 for ever. units: of each joint (n,).
    """

    path: Array
    path_velocity: Array
    goal: Array
    goal_velocity: Array
    goal_time: float
    units: tuple[Units, ...]

    def asked(
        self,
        joints: Sequence[str],
        path: Iterable[JointTolerance],
        goal: Iterable[JointTolerance],
        goal_time: float,
    ) -> Tolerances:
        """With what a goal asks for; joints that nobody knows are passed over."""
        new = {name: getattr(self, name).copy() for name in ("path", "path_velocity", "goal", "goal_velocity")}
        for where, entries in (("path", path), ("goal", goal)):
            for entry in entries:
                if entry.name in joints:
                    j = joints.index(entry.name)
                    new[where][j] = _asked(entry.position, new[where][j])
                    new[f"{where}_velocity"][j] = _asked(entry.velocity, new[f"{where}_velocity"][j])
        return replace(self, **new, goal_time=_asked(goal_time, self.goal_time))


def tolerances(values: Mapping[str, Any], units: tuple[Units, ...]) -> Tolerances:
    """The tolerances that the parameters constraints.* describe for joints with these units (n,)."""
    n = len(units)
    path, goal = (vector(values, f"constraints.{name}", n) for name in ("trajectory", "goal"))
    stopped = np.full(n, values["constraints.stopped_velocity_tolerance"])
    return Tolerances(path, np.zeros(n), goal, stopped, values["constraints.goal_time"], units)


@dataclass(frozen=True, eq=False)
class Goal:
    """A trajectory that is followed until the stamp `end` [ns], within tolerances."""

    joints: tuple[str, ...]
    end: float
    tolerances: Tolerances

    def judge(self, stamp: int, q_tilde_l: Array, dq_tilde_l: Array) -> Outcome | None:
        """The outcome with these errors (n,) [rad], [rad/s] at the stamp [ns]; None while it is open."""
        t = self.tolerances
        if stamp < self.end:
            broken = self._broken("position", q_tilde_l, t.path) or self._broken(
                "velocity", dq_tilde_l, t.path_velocity
            )
            return Outcome(Code.PATH_TOLERANCE_VIOLATED, f"on the way, {broken}") if broken else None
        broken = self._broken("position", q_tilde_l, t.goal) or self._broken("velocity", dq_tilde_l, t.goal_velocity)
        if not broken:
            return Outcome(Code.SUCCESSFUL, "the goal is reached")
        if t.goal_time and stamp - self.end > t.goal_time * 1e9:
            return Outcome(Code.GOAL_TOLERANCE_VIOLATED, f"{t.goal_time:g} s after the last point, {broken}")
        return None

    def _broken(self, what: str, errors: Array, largest: Array) -> str:
        over = np.flatnonzero((largest > 0) & ~(np.abs(errors) <= largest))
        if not over.size:
            return ""
        j = int(over[0])
        unit = getattr(self.tolerances.units[j], what)
        return f"{self.joints[j]} is off by {errors[j]:.3g} {unit}; expected at most {largest[j]:g}"


def _asked(value: float, default: float) -> float:
    return default if value == 0 else max(float(value), 0.0)
