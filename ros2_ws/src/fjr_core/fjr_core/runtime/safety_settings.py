# SPDX-License-Identifier: Apache-2.0
"""Safety settings of the controller: limits, stop policy, start and recovery, each declared with its parameter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..model.joints import REVOLUTE, JointLimits, Units
from ..numerics.checks import freeze, joint_names, limits
from ..numerics.parameter_field import VECTOR, declared, parameter_field

ZERO, GRAVITY_HOLD = "zero", "gravity_hold"
REPORT, STOP, YIELD = REACTIONS = ("report", "stop", "yield")
"""Reactions to contact, in the order of enum fjr_reaction."""
SHORTEST = 1e-3  # s; shortest duration that is not 0
_DURATION = f"0, or at least {SHORTEST} s"


_limit = partial(parameter_field, name="limits.", minimum=0.0, dynamic=True, infinite=True, shape=VECTOR)
_duration = partial(parameter_field, unit="s", minimum=0.0, maximum=1e3, constraint=_DURATION, dynamic=True)


@dataclass(frozen=True, eq=False)
class Settings:
    """Safety settings; by default no limit is active.

    joints: names (n,). units: of each joint, revolute by default; prismatic joints have m and N in place of rad and
    N m. Limits are (n,) or scalars, infinite to disable. The fields declare units, ranges and descriptions.
    Raises ParameterError, which names the parameter, for a wrong length, NaN, a negative bound of a magnitude, a
    lower limit above the upper one, or a duration between 0 and SHORTEST.
    """

    joints: tuple[str, ...]
    effort: ArrayLike = _limit(math.inf, "Largest effort; the command saturates there", "N m")
    effort_rate: ArrayLike = _limit(
        math.inf, "Largest rate of change of the effort, over the time between the stamps of two states", "N m/s"
    )
    link_position_lower: ArrayLike = _limit(
        -math.inf, "Lower limit of q_l; a state below it triggers on_stop", "rad", minimum=-math.inf
    )
    link_position_upper: ArrayLike = _limit(
        math.inf,
        "Upper limit of q_l; a state above it triggers on_stop",
        "rad",
        minimum=-math.inf,
        constraint="at least limits.link_position_lower",
    )
    motor_position_lower: ArrayLike = _limit(
        -math.inf, "Lower limit of q_m; a state below it triggers on_stop", "rad", minimum=-math.inf
    )
    motor_position_upper: ArrayLike = _limit(
        math.inf,
        "Upper limit of q_m; a state above it triggers on_stop",
        "rad",
        minimum=-math.inf,
        constraint="at least limits.motor_position_lower",
    )
    link_velocity: ArrayLike = _limit(math.inf, "Largest |dq_l|; a state above it triggers on_stop", "rad/s")
    motor_velocity: ArrayLike = _limit(math.inf, "Largest |dq_m|; a state above it triggers on_stop", "rad/s")
    deflection: ArrayLike = _limit(math.inf, "Largest |q_m - q_l|; a state above it triggers on_stop", "rad")
    tracking_error: ArrayLike = _limit(math.inf, "Largest |q_l - q_ld|; a state above it triggers on_stop", "rad")
    acceleration: ArrayLike = _limit(
        math.inf,
        "Largest |ddq_ld| of a trajectory, which is refused beyond it, and of a transition, which takes longer; "
        "without it a transition accelerates as the reference does, or by hold.deceleration",
        "rad/s^2",
    )
    start_error: ArrayLike = _limit(
        math.inf,
        "Largest |q_l - q_ld| at which tracking starts without a transition; infinite: none with start.join_time 0, "
        "else every start has one",
        "rad",
    )
    on_stop: str = parameter_field(
        ZERO,
        "Effort after a stop, after state_timeout and at shutdown: zero, or gravity compensation with motor damping",
        choices=(ZERO, GRAVITY_HOLD),
        dynamic=True,
    )
    on_contact: str = parameter_field(
        REPORT,
        "Reaction to contact, the external torque that robot.deviations.* do not explain: report it; stop, with the "
        "effort of on_stop; or yield, gravity compensation with motor damping until it has ended",
        choices=REACTIONS,
        dynamic=True,
    )
    state_timeout: float = parameter_field(
        0.5,
        "Longest time without a state before on_stop applies; a stamp that jumps back by more restarts the reference",
        "s",
        minimum=1e-3,
        maximum=1e3,
    )
    ramp_time: float = _duration(
        0.0, "Duration of the ramp from the effort of on_stop to that of the law; 0: none", name="start.ramp_time"
    )
    start_join_time: float = _duration(
        0.0,
        "Least duration of the transition from a displaced or moving robot to the reference; 0: none; "
        "default 1 s for an arm of a URDF",
        name="start.join_time",
    )
    recovery_join_time: float = _duration(
        1.0,
        "Least duration of the transition after a stop, a gap of the states or a change of the reference; 0: none",
        name="recovery.join_time",
    )
    recovery_longest_gap: float = _duration(
        5.0,
        "Longest gap of the states after which the arm recovers by itself; a longer one in real time stops it; 0: none",
        name="recovery.longest_gap",
    )
    hold_deceleration: float = parameter_field(
        2.0,
        "Mean deceleration to standstill on ~/hold",
        "rad/s^2",
        name="hold.deceleration",
        minimum=1e-3,
        maximum=1e4,
        dynamic=True,
    )
    units: tuple[Units, ...] = ()
    wiring_check: bool = parameter_field(
        True,
        "Stop if the first samples reveal exchanged joints or a wrong sign of an effort or encoder",
        name="start.wiring_check",
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", joint_names("joints", self.joints, ParameterError))
        object.__setattr__(self, "units", self.units or (REVOLUTE,) * self.n)
        for field, parameter in declared(Settings).items():
            value = getattr(self, field)
            if parameter.shape == VECTOR:
                array = limits(f"parameter '{parameter.name}'", value, self.n, ParameterError)
                if np.any(array < parameter.minimum):
                    expected = f"expected {parameter.range}, infinite for no limit"
                    raise ParameterError(f"parameter '{parameter.name}' is {array.tolist()}; {expected}")
                freeze(self, field, array)
            elif parameter.constraint == _DURATION and not (value == 0 or value >= SHORTEST):
                expected = f"0 for none, or at least {SHORTEST} s"
                raise ParameterError(f"parameter '{parameter.name}' is {value} s; expected {expected}")
        for limit in ("link_position", "motor_position"):
            bounds = getattr(self, f"{limit}_lower"), getattr(self, f"{limit}_upper")
            for joint, unit, lower, upper in zip(self.joints, self.units, *bounds, strict=True):
                if lower > upper:
                    raise ParameterError(
                        f"parameter 'limits.{limit}_upper' of {joint} is {upper:g} {unit.position}; "
                        f"expected at least its 'limits.{limit}_lower', {lower:g} {unit.position}"
                    )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def tightened(self, robot: JointLimits | None) -> Settings:
        """Return these settings with the tighter of both limits: range and speed of the links, effort of the motors."""
        if robot is None:
            return self
        return replace(
            self,
            effort=np.minimum(self.effort, robot.effort),
            link_velocity=np.minimum(self.link_velocity, robot.velocity),
            link_position_lower=np.maximum(self.link_position_lower, robot.lower),
            link_position_upper=np.minimum(self.link_position_upper, robot.upper),
        )
