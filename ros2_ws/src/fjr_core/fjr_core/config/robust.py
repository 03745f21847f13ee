# SPDX-License-Identifier: Apache-2.0
"""Robust action in words: the parameters robust.*, and the options that their values describe."""

from __future__ import annotations

from ..control.robust.options import FASTEST, HOLD, Robust
from .parameter import Parameter, Values, named, vector

_WORDS = {
    "residual_gain": "Rate of the estimate of a torque on the links, fed forward; 0: none",
    "motor_residual_gain": "Rate of the estimate of a torque on the motors, fed forward; 0: none",
    "integral_gain": "Rate at which integral action takes up a torque on the links; 0: none",
    "motor_integral_gain": "Rate at which integral action takes up a torque on the motors; 0: none",
}


def robust_parameters(n: int) -> list[Parameter]:
    """The parameters for n joints; everything is off by default."""
    gains = [
        Parameter(f"robust.{name}", (0.0,) * n, text, "1/s", constraint=f"0 to {FASTEST:g}")
        for name, text in _WORDS.items()
    ]
    delay = "Delay of the loop, over which the law predicts the state; 0: no prediction"
    hold = "Period of the states, half of which counts to robust.delay"
    return [
        *gains,
        Parameter("robust.delay", 0.0, delay, "s", minimum=0.0, maximum=0.1),
        Parameter("robust.hold", HOLD, hold, "s", minimum=1e-5, maximum=1.0),
    ]


def robust(values: Values, n: int) -> Robust:
    """The options of the values for n joints; raises ParameterError."""
    gains = {name: vector(values, f"robust.{name}", n) for name in _WORDS}
    delay, hold = float(values["robust.delay"]), float(values["robust.hold"])  # type: ignore[arg-type]
    return named(lambda symbol: f"robust.{symbol}", lambda: Robust(**gains, delay=delay, hold=hold).checked(n))
