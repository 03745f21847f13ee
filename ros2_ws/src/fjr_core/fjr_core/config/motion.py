# SPDX-License-Identifier: Apache-2.0
"""What the controller may be asked to do, and when it has done it: limits of trajectories and tolerances in words."""

from __future__ import annotations

import math

from ..robot.robot import Robot
from ..trajectories.motion_limits import MotionLimits
from .parameter import Parameter, Values, vector
from .safety import safety


def motion_parameters(n: int) -> list[Parameter]:
    """The parameters for n joints."""
    none = (0.0,) * n
    return [
        Parameter(
            "limits.acceleration",
            (math.inf,) * n,
            "Largest |ddq_ld| of a trajectory; a larger one is refused",
            "rad/s^2",
            minimum=0.0,
            dynamic=True,
            infinite=True,
        ),
        Parameter("allow_partial_joints", False, "A trajectory may leave joints out, which then hold", dynamic=True),
        Parameter(
            "constraints.trajectory", none, "Largest |q_l - q_ld| on the way to an action's goal, 0 for any", "rad", 0.0
        ),
        Parameter("constraints.goal", none, "Largest |q_l - q_ld| at an action's goal, 0 for any", "rad", 0.0),
        Parameter(
            "constraints.stopped_velocity_tolerance",
            0.01,
            "Largest |dq_l| at an action's goal, 0 for any",
            "rad/s",
            minimum=0.0,
        ),
        Parameter(
            "constraints.goal_time", 0.0, "Time after its end to reach an action's goal, 0 for any", "s", minimum=0.0
        ),
    ]


def motion_limits(values: Values, robot: Robot) -> MotionLimits:
    """The robot's own limits, tightened by limits.*, with limits.acceleration; raises ParameterError."""
    settings = safety(values, robot)
    held = settings if robot.limits is None else settings.tightened(robot.limits)
    return MotionLimits(
        held.link_position_lower,
        held.link_position_upper,
        held.link_velocity,
        vector(values, "limits.acceleration", robot.n),
        robot.units,
    )
