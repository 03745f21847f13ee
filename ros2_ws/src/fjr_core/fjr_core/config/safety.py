# SPDX-License-Identifier: Apache-2.0
"""Parameters of the safety settings: limits, stop policy, start and recovery."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..errors import ParameterError
from ..model.robot import Robot
from ..numerics.parameter_field import declared
from ..runtime.safety_settings import Settings
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
