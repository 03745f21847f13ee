# SPDX-License-Identifier: Apache-2.0
"""Options of the robust action of a law; everything is off by default."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from ...errors import GainsError
from ...numerics import checks
from ...numerics.checks import Array
from ...numerics.parameter_field import VECTOR, parameter_field

GAINS = ("residual_gain", "motor_residual_gain", "integral_gain", "motor_integral_gain")
HOLD = 1e-3  # s
LONGEST_DELAY = 32  # samples of hold
FASTEST = 1e4  # 1/s, largest gain


_gain_field = partial(parameter_field, 0.0, unit="1/s", shape=VECTOR, constraint=f"0 to {FASTEST:g}")


@dataclass(frozen=True, eq=False)
class Robust:
    """Options of the robust action (docs/robust.md); each gain is a scalar or (n,), 0 (off) to FASTEST.

    residual_gain [1/s]: bandwidth L of the estimate of the link disturbance, which is fed forward.
    motor_residual_gain [1/s]: bandwidth of the estimate of the motor disturbance. integral_gain [1/s]: rate at which
    the integral compensates a link torque. motor_integral_gain [1/s]: rate for a motor torque.
    delay [s]: loop delay over which the state is predicted; 0 disables the prediction. hold [s]: hold period of the
    effort, equal to the sample period; half of it is added to the prediction.
    """

    residual_gain: ArrayLike = _gain_field("Bandwidth of the link disturbance observer (feedforward); 0: off")
    motor_residual_gain: ArrayLike = _gain_field("Bandwidth of the motor disturbance observer (feedforward); 0: off")
    integral_gain: ArrayLike = _gain_field("Rate of the integral action on the links; 0: off")
    motor_integral_gain: ArrayLike = _gain_field("Rate of the integral action on the motors; 0: off")
    delay: float = parameter_field(
        0.0,
        "Loop delay over which the Smith predictor predicts the state; 0: no prediction",
        "s",
        minimum=0.0,
        maximum=0.1,
    )
    hold: float = parameter_field(
        HOLD, "Sample period; half of it is added to robust.delay", "s", minimum=1e-5, maximum=1.0
    )

    def checked(self, n: int) -> Robust:
        """Return the options with gains (n,). Raises GainsError for a wrong range or shape, or a non-finite value."""
        gains = {name: _gain(name, getattr(self, name), n) for name in GAINS}
        for name, value in (("delay", self.delay), ("hold", self.hold)):
            if not (np.isfinite(value) and value >= 0):
                raise GainsError(f"{name} is {value} s; expected a finite number of 0 or more")
        if self.delay and not self.delay <= LONGEST_DELAY * self.hold:
            raise GainsError(
                f"delay is {self.delay} s with a hold of {self.hold} s; expected at most {LONGEST_DELAY} holds"
            )
        checked = replace(self, **gains)  # type: ignore[arg-type]
        if checked.integrates and not self.hold:
            raise GainsError(f"hold is {self.hold} s with an integral; expected more than 0")
        return checked

    @property
    def estimates(self) -> bool:
        """True if disturbance torques are estimated."""
        return bool(np.any(self.residual_gain) or np.any(self.motor_residual_gain))

    @property
    def integrates(self) -> bool:
        """True with integral action."""
        return bool(np.any(self.integral_gain) or np.any(self.motor_integral_gain))

    @property
    def predicts(self) -> bool:
        """True if the state is predicted."""
        return self.delay > 0

    @property
    def off(self) -> bool:
        """True without any robust action."""
        return not (self.estimates or self.integrates or self.predicts)

    @property
    def lead(self) -> float:
        """Prediction horizon [s]: the delay plus half of the hold period."""
        return self.delay + self.hold / 2 if self.predicts else 0.0


def _gain(name: str, value: ArrayLike, n: int) -> Array:
    array = checks.vector(name, value, n, GainsError)
    if not np.all((array >= 0) & (array <= FASTEST)):
        raise GainsError(f"{name} is {array.tolist()} 1/s; expected 0 to {FASTEST:g}")
    array.setflags(write=False)
    return array
