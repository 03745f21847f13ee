# SPDX-License-Identifier: Apache-2.0
"""Limits, stop policy, start and recovery of the controller as checked values."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..numerics.checks import Array
from ..robot.joint_limits import JointLimits
from ..robot.joint_units import REVOLUTE, Units

ZERO, GRAVITY_HOLD = "zero", "gravity_hold"
LIMITS = (
    "effort",
    "effort_rate",
    "link_position_lower",
    "link_position_upper",
    "motor_position_lower",
    "motor_position_upper",
    "link_velocity",
    "motor_velocity",
    "deflection",
    "tracking_error",
    "start_error",
)
"""Settings with one bound for each joint, infinite for none; `limits.<name>` among the parameters."""
_DURATIONS = {
    "ramp_time": "start.ramp_time",
    "start_join_time": "start.join_time",
    "recovery_join_time": "recovery.join_time",
}
SHORTEST = 1e-3  # s; of a duration that is not 0


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
        for name in LIMITS:
            array = _bounds(name, getattr(self, name), len(self.joints))
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        for upper in ("link_position_upper", "motor_position_upper"):
            _check_order(self.joints, self.units, upper, getattr(self, lower_of(upper)), getattr(self, upper))
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


def lower_of(upper: str) -> str:
    """Return the name of the lower limit that belongs to an upper one."""
    return upper.replace("upper", "lower")


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
                f"expected at least its 'limits.{lower_of(upper)}', {a:g} {unit.position}"
            )
