# SPDX-License-Identifier: Apache-2.0
"""The parameters that choose the controller's law."""

from __future__ import annotations

from ..control.registry import LAWS, V_DPBC
from ..tuning.bandwidth import START_ERROR
from .parameter import Parameter


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
