# SPDX-License-Identifier: Apache-2.0
"""Limits, stop policy, start and recovery of the controller in words, and the settings that their values describe."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..numerics.checks import Array
from ..robot.joint_limits import JointLimits
from ..robot.joint_units import REVOLUTE, Units
from ..robot.robot import Robot
from .parameter import Parameter, Values, names, vector

ZERO, GRAVITY_HOLD = "zero", "gravity_hold"

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
_LIMITS = tuple(_WORDS)
_DURATIONS = {
    "ramp_time": "start.ramp_time",
    "start_join_time": "start.join_time",
    "recovery_join_time": "recovery.join_time",
}
SHORTEST = 1e-3  # s


def safety_parameters(n: int) -> list[Parameter]:
    """The parameters for n joints; everything but state_timeout and recovery is off by default."""
    return [
        *(_limit(name, n) for name in _LIMITS),
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
    constraint = f"at least limits.{_lower(name)}" if name.endswith("upper") else ""
    return Parameter(
        f"limits.{name}", (off,) * n, text, unit, minimum, constraint=constraint, dynamic=True, infinite=True
    )


def _duration(name: str, default: float, text: str) -> Parameter:
    return Parameter(name, default, text, "s", 0.0, 1e3, constraint=f"0, or at least {SHORTEST} s", dynamic=True)


def _lower(upper: str) -> str:
    return upper.replace("upper", "lower")


@dataclass(frozen=True, eq=False)
class Settings:
    """What keeps the closed loop safe; checked at birth. Without arguments but the joints, nothing limits anything.

    joints: names (n,). units: of each joint, revolute by default; prismatic ones have m and N below.
    Limits, each (n,) or a scalar, infinite for none: effort [N m], effort_rate [N m/s],
    link_position_lower .. motor_position_upper [rad], link_velocity, motor_velocity [rad/s], deflection
    |q_m - q_l|, tracking_error and start_error |q_l - q_ld| [rad]. on_stop: "zero" or "gravity_hold".
    Times [s]: state_timeout, ramp_time, start_join_time, recovery_join_time. hold_deceleration [rad/s^2].
    wiring_check: stop at exchanged joints and wrong signs.
    Raises ParameterError, which names the parameter, for other lengths, NaN, a negative bound of a size, a
    lower limit above the upper one, or a time between 0 and SHORTEST.
    """

    joints: tuple[str, ...]
    effort: ArrayLike = math.inf
    effort_rate: ArrayLike = math.inf
    link_position_lower: ArrayLike = -math.inf
    link_position_upper: ArrayLike = math.inf
    motor_position_lower: ArrayLike = -math.inf
    motor_position_upper: ArrayLike = math.inf
    link_velocity: ArrayLike = math.inf
    motor_velocity: ArrayLike = math.inf
    deflection: ArrayLike = math.inf
    tracking_error: ArrayLike = math.inf
    start_error: ArrayLike = math.inf
    on_stop: str = ZERO
    state_timeout: float = 0.5
    ramp_time: float = 0.0
    start_join_time: float = 0.0
    recovery_join_time: float = 1.0
    hold_deceleration: float = 2.0
    units: tuple[Units, ...] = ()
    wiring_check: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "units", self.units or (REVOLUTE,) * self.n)
        for name in _LIMITS:
            array = _bounds(name, getattr(self, name), len(self.joints))
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        for upper in ("link_position_upper", "motor_position_upper"):
            _check_order(self.joints, self.units, upper, getattr(self, _lower(upper)), getattr(self, upper))
        for name, word in _DURATIONS.items():
            if not (getattr(self, name) == 0 or getattr(self, name) >= SHORTEST):
                raise ParameterError(
                    f"parameter '{word}' is {getattr(self, name)} s; expected 0 for none, or at least {SHORTEST} s"
                )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def tightened(self, limits: JointLimits) -> Settings:
        """These settings where `limits` hold too: on range and speed of the links and on the effort."""
        return replace(
            self,
            effort=np.minimum(self.effort, limits.effort),
            link_velocity=np.minimum(self.link_velocity, limits.velocity),
            link_position_lower=np.maximum(self.link_position_lower, limits.lower),
            link_position_upper=np.minimum(self.link_position_upper, limits.upper),
        )


def safety(values: Values, robot: Robot) -> Settings:
    """The settings of the values; raises ParameterError, also where the robot has no limits that are asked for."""
    limits = {name: vector(values, f"limits.{name}", robot.n) for name in _LIMITS}
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


def _bounds(name: str, value: ArrayLike, n: int) -> Array:
    array = np.array(np.broadcast_to(value, (n,)) if np.ndim(value) == 0 else value, dtype=float)
    if array.shape != (n,):
        raise ParameterError(f"parameter 'limits.{name}' has {array.size} entries; expected {n}, one per joint")
    signed = "position" in name
    if np.any(np.isnan(array)) or not (signed or np.all(array >= 0)):
        kind = "numbers" if signed else "numbers of at least 0"
        raise ParameterError(f"parameter 'limits.{name}' is {array.tolist()}; expected {kind}, infinite for no limit")
    return array


def _check_order(joints: tuple[str, ...], units: tuple[Units, ...], upper: str, low: Array, high: Array) -> None:
    for joint, unit, a, b in zip(joints, units, low, high, strict=True):
        if a > b:
            raise ParameterError(
                f"parameter 'limits.{upper}' of {joint} is {b:g} {unit.position}; "
                f"expected at least its 'limits.{_lower(upper)}', {a:g} {unit.position}"
            )
