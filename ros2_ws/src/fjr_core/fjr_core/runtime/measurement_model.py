# SPDX-License-Identifier: Apache-2.0
"""Describe the measured joint signals: velocities or none, motor positions behind gears, or joint torques."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import ParameterError
from ..numerics import checks
from ..numerics.checks import Array
from ..numerics.one_line import one_line
from ..numerics.parameter_field import VECTOR, parameter_field

MEASURED, OBSERVER = "measured", "observer"
POSITION, TORQUE = "position", "torque"


@dataclass(frozen=True, eq=False)
class Measurement:
    """Sources of velocities and motor positions of n joints.

    velocity: "measured", or "observer": estimated, and measured velocities are ignored.
    motor: "position", or "torque": a sensor measures the joint torque tau = K zeta, and q_m = q_l + K^-1 tau.
    gear_ratio (n,): motor angle before the gear = gear_ratio q_m; negative if the gear reverses the direction.
    K (n, n): joint stiffness [N m/rad], None if motor is "position".

    Raises ParameterError for an unknown option, a ratio that is 0 or not finite, or torque without a stiffness, with
    measured velocities (the torque rate is not measured) or with a gear ratio.
    """

    n: int
    velocity: str = parameter_field(
        MEASURED,
        "Source of the velocities: the states, or an observer driven by positions and effort",
        choices=(MEASURED, OBSERVER),
    )
    motor: str = parameter_field(
        POSITION,
        "Source of the motor state: the motor position, or the joint torque sensor (effort of the link-side name)",
        choices=(POSITION, TORQUE),
    )
    gear_ratio: Array | float = parameter_field(
        1.0,
        "Motor turns in the states per turn of q_m; negative: opposite direction",
        "1",
        shape=VECTOR,
        constraint="not 0",
    )
    K: Array | None = None

    __repr__ = one_line

    def __post_init__(self) -> None:
        for name, options in (("velocity", (MEASURED, OBSERVER)), ("motor", (POSITION, TORQUE))):
            if (value := getattr(self, name)) not in options:
                raise ParameterError(f"measurement.{name} is {value!r}; expected one of {', '.join(options)}")
        ratio = checks.vector("measurement.gear_ratio", self.gear_ratio, self.n, ParameterError)
        if not np.all(ratio):
            raise ParameterError(f"measurement.gear_ratio is {ratio.tolist()}; expected no zeros")
        checks.freeze(self, "gear_ratio", ratio)
        if self.motor != TORQUE:
            return
        if not self.observed:
            raise ParameterError(
                f"measurement.velocity is '{self.velocity}' with measurement.motor 'torque'; expected '{OBSERVER}', "
                "since a torque sensor does not measure the motor velocity"
            )
        if np.any(np.asarray(self.gear_ratio) != 1):
            ratio = np.asarray(self.gear_ratio).tolist()
            raise ParameterError(
                f"measurement.gear_ratio is {ratio} with measurement.motor 'torque'; expected 1, no motor angle is read"
            )
        if self.K is None:
            raise ParameterError("K is None with measurement.motor 'torque'; expected the joint stiffness")
        object.__setattr__(self, "K", checks.matrix("K", self.K, self.n, ParameterError))

    @property
    def observed(self) -> bool:
        """True if an observer estimates the velocities."""
        return self.velocity == OBSERVER

    @property
    def by_torque(self) -> bool:
        """True if motor positions are computed from joint torques."""
        return self.motor == TORQUE
