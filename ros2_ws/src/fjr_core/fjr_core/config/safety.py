# SPDX-License-Identifier: Apache-2.0
"""Parameters of the safety settings: limits, stop policy, start and recovery, and the limits of efforts and motions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..errors import ParameterError
from ..law.safety_settings import Settings
from ..model.robot import Robot
from ..motions.motion_limits import MotionLimits
from ..numerics.checks import Array
from ..numerics.parameter_field import declared
from .parameter import Parameter, Values, names, read, table

FROM_ROBOT = Parameter(
    "limits.from_robot",
    False,
    "Apply the robot's own limits too (link range and speed, motor effort); the tighter limit counts",
    dynamic=True,
)
_DECLARED = declared(Settings)
JOIN_TIME = 1.0  # s; default of start.join_time for an arm of a URDF


def safety_parameters(n: int) -> list[Parameter]:
    """Return the parameters for n joints; by default only state_timeout, wiring check and recovery are active."""
    return [*table(_DECLARED, n), FROM_ROBOT]


def with_robot(parameters: Sequence[Parameter], given: Mapping[str, object]) -> list[Parameter]:
    """Return the parameters with the defaults for the given robot: an arm of a URDF starts by a transition."""
    if given.get("robot.model") != "urdf":
        return list(parameters)
    join = _DECLARED["start_join_time"].name
    return [replace(each, default=JOIN_TIME) if each.name == join else each for each in parameters]


def safety(values: Values, robot: Robot) -> Settings:
    """Return the safety settings of the values.

    Raises ParameterError, also if limits.from_robot is true for a robot without limits.
    """
    own = Settings(names(values, "joints"), **read(_DECLARED, values, robot.n), units=robot.units)
    if not values[FROM_ROBOT.name]:
        return own
    if robot.limits is None:
        raise ParameterError(f"parameter '{FROM_ROBOT.name}' is true; expected false for a robot without limits")
    return own.tightened(robot.limits)


def effort_limits(values: Values, robot: Robot) -> Array:
    """Return the effort limits (n,) [N m]: the tighter of limits.effort and those of the robot, infinite for none."""
    limit = np.asarray(safety(values, robot).effort)
    return limit if robot.limits is None else np.minimum(limit, robot.limits.effort)


def motion_limits(settings: Settings, robot: Robot) -> MotionLimits:
    """Return the limits of trajectories: the tighter of settings and robot; raises ParameterError."""
    held = settings if robot.limits is None else settings.tightened(robot.limits)
    return MotionLimits(
        held.link_position_lower,
        held.link_position_upper,
        held.link_velocity,
        settings.acceleration,
        robot.units,
    )
