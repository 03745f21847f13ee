# SPDX-License-Identifier: Apache-2.0
"""Options of the robust action, which are the parameters robust.*, with their ranges."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainsError
from ..numerics import checks
from ..numerics.parameter_field import VECTOR, parameter_field

GAINS = ("residual_gain", "motor_residual_gain", "integral_gain", "motor_integral_gain")
HOLD = 1e-3  # s
LONGEST_DELAY = 32  # samples of hold
FASTEST = 1e4  # 1/s, largest gain
_gain_field = partial(parameter_field, 0.0, unit="1/s", shape=VECTOR, constraint=f"0 to {FASTEST:g}")


@dataclass(frozen=True, eq=False)
class Robust:
    """Options of the robust action (docs/robust.md); each gain is a scalar or (n,), 0 (off) to FASTEST."""

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
        gains = {name: checks.vector(name, getattr(self, name), n, GainsError) for name in GAINS}
        for name, array in gains.items():
            if not np.all((array >= 0) & (array <= FASTEST)):
                raise GainsError(f"{name} is {array.tolist()} 1/s; expected 0 to {FASTEST:g}")
            array.setflags(write=False)
        delay, hold = (checks.positive(k, getattr(self, k), GainsError, zero=True) for k in ("delay", "hold"))
        if delay > LONGEST_DELAY * hold:
            raise GainsError(f"delay is {delay} s with a hold of {hold} s; expected at most {LONGEST_DELAY} holds")
        checked = replace(self, **gains, delay=delay, hold=hold)
        if checked.integrates and not hold:
            raise GainsError(f"hold is {hold} s with an integral; expected more than 0")
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
