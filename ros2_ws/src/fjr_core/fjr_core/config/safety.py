# SPDX-License-Identifier: Apache-2.0
"""Limits, stop policy, start and recovery of the controller in words, and the settings that their values describe."""

from __future__ import annotations

import math

from ..control.safety_settings import GRAVITY_HOLD, LIMITS, SHORTEST, ZERO, Settings, lower_of
from ..errors import ParameterError
from ..robot.robot import Robot
from .parameter import Parameter, Values, names, vector

_WORDS = {
    "effort": ("N m", "Largest effort; more is cut off"),
    "effort_rate": ("N m/s", "Largest change of the effort between two states, per second between their stamps"),
    "link_position_lower": ("rad", "Smallest q_l; below, the stop policy acts"),
    "link_position_upper": ("rad", "Largest q_l; above, the stop policy acts"),
    "motor_position_lower": ("rad", "Smallest q_m; below, the stop policy acts"),
    "motor_position_upper": ("rad", "Largest q_m; above, the stop policy acts"),
    "link_velocity": ("rad/s", "Largest |dq_l|; above, the stop policy acts"),
    "motor_velocity": ("rad/s", "Largest |dq_m|; above, the stop policy acts"),
    "deflection": ("rad", "Largest |q_m - q_l|; above, the stop policy acts"),
    "tracking_error": ("rad", "Largest |q_l - q_ld|; above, the stop policy acts"),
    "start_error": ("rad", "Largest |q_l - q_ld| with which tracking begins, where start.join_time is 0"),
}


def safety_parameters(n: int) -> list[Parameter]:
    """The parameters for n joints; everything but state_timeout and recovery is off by default."""
    return [
        *(_limit(name, n) for name in LIMITS),
        Parameter(
            "limits.from_robot",
            False,
            "The robot's own limits hold too, the tighter ones: range and speed of the links, effort of the motors",
            dynamic=True,
        ),
        Parameter(
            "on_stop",
            ZERO,
            "Effort after a stop, a silence and at the end: none, or the weight of the links with damped motors",
            choices=(ZERO, GRAVITY_HOLD),
            dynamic=True,
        ),
        Parameter(
            "state_timeout",
            0.5,
            "Without a state for longer, the stop policy acts; a stamp that jumps back by more restarts the reference",
            "s",
            minimum=1e-3,
            maximum=1e3,
        ),
        Parameter(
            "start.wiring_check",
            True,
            "Stop where the first samples show exchanged joints or a wrong sign of an effort or encoder",
        ),
        _duration("start.ramp_time", 0.0, "Time from on_stop's effort to the law's at the start, 0 for none"),
        _duration("start.join_time", 0.0, "Time of the motion from the first state into the reference, 0 for none"),
        _duration("recovery.join_time", 1.0, "The same after a silence, a stop or for another reference, 0 for none"),
        Parameter(
            "hold.deceleration", 2.0, "Mean deceleration when the motion is held", "rad/s^2", 1e-3, 1e4, dynamic=True
        ),
    ]


def _limit(name: str, n: int) -> Parameter:
    unit, text = _WORDS[name]
    off = -math.inf if name.endswith("lower") else math.inf
    minimum = -math.inf if "position" in name else 0.0
    constraint = f"at least limits.{lower_of(name)}" if name.endswith("upper") else ""
    return Parameter(
        f"limits.{name}", (off,) * n, text, unit, minimum, constraint=constraint, dynamic=True, infinite=True
    )


def _duration(name: str, default: float, text: str) -> Parameter:
    return Parameter(name, default, text, "s", 0.0, 1e3, constraint=f"0, or at least {SHORTEST} s", dynamic=True)


def safety(values: Values, robot: Robot) -> Settings:
    """The settings of the values; raises ParameterError, also where the robot has no limits that are asked for."""
    limits = {name: vector(values, f"limits.{name}", robot.n) for name in LIMITS}
    own = Settings(
        names(values, "joints"),
        **limits,
        on_stop=str(values["on_stop"]),
        state_timeout=_number(values, "state_timeout"),
        ramp_time=_number(values, "start.ramp_time"),
        start_join_time=_number(values, "start.join_time"),
        recovery_join_time=_number(values, "recovery.join_time"),
        hold_deceleration=_number(values, "hold.deceleration"),
        units=robot.units,
        wiring_check=bool(values["start.wiring_check"]),
    )
    if not values["limits.from_robot"]:
        return own
    if robot.limits is None:
        raise ParameterError("parameter 'limits.from_robot' is true; expected false for a robot without limits")
    return own.tightened(robot.limits)


def _number(values: Values, name: str) -> float:
    value = values[name]
    assert isinstance(value, (int, float))
    return float(value)
