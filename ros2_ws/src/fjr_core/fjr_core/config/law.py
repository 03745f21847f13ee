# SPDX-License-Identifier: Apache-2.0
"""Parameters law.* and robust.*: the control law, its tuning, and the robust action."""

from __future__ import annotations

from ..law.registry import LAWS, V_DPBC
from ..law.robust.options import Robust
from ..numerics.parameter_field import declared
from .parameter import LIST, VECTOR, Parameter, Values, named, read

START_ERROR = 0.1  # rad; initial error of all joints, at rest, if no start is given

TYPE = Parameter(
    "law.type",
    V_DPBC,
    "Control law; the gains of v_dpbc are gains.*, the options of a class module:Class are law.options.*",
    choices=LAWS,
    options="law.options.",
)
TUNED = Parameter(
    "law.tuned",
    True,
    "true: tune the selected law to the bandwidth that v_dpbc has with gains.* (docs/compare.md); false: "
    "compute its gains from law.natural_frequency and law.damping_ratio. v_dpbc always uses gains.*, a class options",
)
NATURAL_FREQUENCY = Parameter(
    "law.natural_frequency",
    20.0,
    "Natural frequency of the closed loop if law.tuned is false",
    "rad/s",
    minimum=1e-3,
    maximum=1e4,
)
DAMPING_RATIO = Parameter(
    "law.damping_ratio", 1.0, "Damping ratio of the closed loop if law.tuned is false", minimum=1e-2, maximum=1e2
)
GAIN_FACTORS = Parameter(
    "law.gain_factors",
    (1.0,),
    "Factors on the gains of a law other than v_dpbc that docs/tuning.md lists: one for all, or one each",
    minimum=1e-4,
    maximum=1e4,
    shape=LIST,
)
INITIAL_ERROR = Parameter(
    "law.start_error",
    START_ERROR,
    "Position error of all joints at rest; tuning makes the peak efforts from there equal",
    "rad",
    shape=VECTOR,
)
SAMPLE_RATE = Parameter(
    "law.sample_rate",
    1e3,
    "Rate of the states; it bounds the fast poles of feedback_linearisation and the apparent motor inertia "
    "of torque_feedback",
    "Hz",
    minimum=1.0,
    maximum=1e5,
)
LAW = (TYPE, TUNED, NATURAL_FREQUENCY, DAMPING_RATIO, GAIN_FACTORS, INITIAL_ERROR, SAMPLE_RATE)
ROBUST = declared(Robust, "robust.")
"""Parameters robust.*; every robust action is off by default."""


def robust(values: Values, n: int) -> Robust:
    """Return the robust action of the values for n joints; raises ParameterError."""
    return named(lambda symbol: f"robust.{symbol}", lambda: Robust(**read(ROBUST, values, n)).checked(n))
