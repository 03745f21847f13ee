# SPDX-License-Identifier: Apache-2.0
"""Parameters that choose the controller's law and its robust action, and the robust action of their values."""

from __future__ import annotations

from ..control.registry import LAWS, V_DPBC
from ..control.robust.options import FASTEST, HOLD, Robust
from ..tuning.bandwidth import START_ERROR
from .parameter import Parameter, Values, named, vector


def law_parameters(n: int) -> list[Parameter]:
    """Parameters `law.*` for n joints; what they build: control_law."""
    return [
        Parameter("law.type", V_DPBC, "Control law; v_dpbc has its gains in gains.*", choices=tuple(LAWS)),
        Parameter(
            "law.tuned",
            True,
            "true: tune the selected law to the bandwidth that v_dpbc has with gains.* (docs/baselines.md); false: "
            "compute its gains from law.natural_frequency and law.damping_ratio. v_dpbc always has gains.*",
        ),
        Parameter(
            "law.natural_frequency",
            20.0,
            "Natural frequency that the gains follow from, where not tuned",
            "rad/s",
            minimum=1e-3,
            maximum=1e4,
        ),
        Parameter(
            "law.damping_ratio",
            1.0,
            "Damping ratio that the gains follow from, where not tuned",
            minimum=1e-2,
            maximum=1e2,
        ),
        Parameter(
            "law.start_error",
            (START_ERROR,) * n,
            "Error of all joints of the start at rest whose peak effort the rule makes equal",
            "rad",
        ),
        Parameter(
            "law.sample_rate",
            1e3,
            "Rate of the states, which bounds the fast poles of feedback_linearisation and the apparent motor inertia "
            "of torque_feedback",
            "Hz",
            minimum=1.0,
            maximum=1e5,
        ),
    ]


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
