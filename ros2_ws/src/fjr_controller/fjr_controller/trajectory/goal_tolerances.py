# SPDX-License-Identifier: Apache-2.0
"""Decide when a goal of FollowJointTrajectory is reached or missed, without ROS.

The rules and the meaning of the parameters are those of ros2_control's joint_trajectory_controller.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np

from fjr_core.config.parameter import vector
from fjr_core.model.robot import Units
from fjr_core.numerics.checks import Array


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
class Goal:
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
