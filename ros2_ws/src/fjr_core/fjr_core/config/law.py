# SPDX-License-Identifier: Apache-2.0
"""Parameters law.*, gains.* and robust.*, and the control law, gains and robust action that they describe."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FjrError, GainsError, ParameterError, prefixed
from ..extensions.law_registry import LAWS, V_DPBC, LawKind, law_kind
from ..files import importing
from ..files.importing import is_named
from ..law.gains import PAPER_GAINS, Gains
from ..numerics.checks import is_diagonal
from ..numerics.parameter_field import declared
from ..robust.options import Robust
from .parameter import LIST, VECTOR, Parameter, Values, named, number, options, read
from .reference import reference

if TYPE_CHECKING:
    from ..law.interfaces import StaticLaw
    from ..model.robot import Robot

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
    "Factors on the gains of a law other than v_dpbc that docs/tables/gains.md lists: one for all, or one each",
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


GAINS = declared(Gains, "gains.", vars(PAPER_GAINS))


def gains(values: Values, n: int) -> Gains:
    """Return the gains of the values for n joints; raises ParameterError where (32) or (41) is broken."""
    found = Gains(**read(GAINS, values, n))
    named(lambda symbol: f"gains.{symbol}" if symbol in GAINS else "gains", lambda: found.checked(n))
    return found


def gain_values(gains: Gains, n: int) -> dict[str, list[float]]:
    """Return the parameters of these gains: n entries if diagonal, else n*n by rows; zero gains are omitted."""
    checked, values = gains.checked(n), {}
    for field, parameter in GAINS.items():
        array = getattr(checked, field)
        if np.any(array):
            values[parameter.name] = [float(v) for v in (np.diag(array) if is_diagonal(array) else array.ravel())]
    return values


def control_law(values: Values, robot: Robot) -> StaticLaw:
    """Return the control law of the values; raises ParameterError.

    It is v-dPBC with gains.*, a baseline, or the class of the user that law.type names, with law.options.*.
    """
    name, compile = str(values[TYPE.name]), bool(values["compile"])
    if name == V_DPBC:
        from ..law.vdpbc import TrackingLaw

        return TrackingLaw(robot, gains(values, robot.n), compile=compile)
    if robot.curve and not is_named(name):
        raise ParameterError(f"parameter '{TYPE.name}' is {name!r} with a robot.{robot.curve}; expected '{V_DPBC}'")
    fault = FjrError if is_named(name) else GainsError
    with prefixed(f"parameter '{TYPE.name}' is {name!r}: ", fault):
        if is_named(name):
            from ..extensions.python_code import own_law

            return own_law(name, robot, options(TYPE, values), compile=compile)
        kind = law_kind(name)
        return kind.make(robot, _baseline_gains(values, robot, kind), compile)


def _baseline_gains(values: Values, robot: Robot, kind: LawKind) -> Any:
    """Return the gains of a baseline: tuned, or of natural frequency and damping ratio; times law.gain_factors."""
    if values[TUNED.name]:
        found = importing.module("fjr_design.tuning.equal_bandwidth").tuning(values).law.gains
    else:
        q_0 = np.asarray(reference(values, robot.n).jets(0.0))[0]
        frequency, damping = number(values, NATURAL_FREQUENCY.name), number(values, DAMPING_RATIO.name)
        found = kind.tuning_rule(robot, q_0, frequency, damping, sample_period(values))
    return kind.scale(found, np.asarray(values[GAIN_FACTORS.name]))


def sample_period(values: Values) -> float:
    """Return the sample period of the law [s]."""
    return 1.0 / number(values, SAMPLE_RATE.name)


def robust_action(values: Values, static_law: StaticLaw) -> Robust:
    """Return the robust action of the values for their law.

    Raises ParameterError, also if the law supports none or the integral action is too fast for robust.hold.
    """
    action = robust(values, static_law.robot.n)
    if action.off:
        return action
    from ..robust.law import sampled_law
    from ..stability.linearization import refuse_fast_integral

    with prefixed(f"parameters 'robust.*' with '{TYPE.name}' {values[TYPE.name]!r}: ", GainsError):
        sampled_law(static_law, action)
        refuse_fast_integral(static_law, action)
    return action
