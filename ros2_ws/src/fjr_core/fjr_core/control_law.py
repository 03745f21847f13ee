# SPDX-License-Identifier: Apache-2.0
"""The controller's law as its parameters describe it: v-dPBC, or one of those that it is compared with."""

from __future__ import annotations

import numpy as np

from . import config
from .errors import GainsError, ParameterError
from .law_slope import rest_position
from .laws import V_DPBC, law_kind
from .parameters import Values, vector
from .robot import Robot
from .static_law import StaticLaw
from .tuning import Tuning, tune
from .vdpbc.law import TrackingLaw
from .yardstick import Yardstick


def control_law(values: Values, robot: Robot) -> StaticLaw:
    """The law of the values; raises ParameterError."""
    name, compile = str(values["law.type"]), bool(values["compile"])
    if name == V_DPBC:
        return TrackingLaw(robot, config.gains(values, robot.n), compile=compile)
    try:
        return tuning(values, robot, compile).law if values["law.tuned"] else _given(values, robot, compile)
    except GainsError as error:
        raise ParameterError(f"parameter 'law.type' is {name!r}: {error}") from None


def tuning(values: Values, robot: Robot, compile: bool = False) -> Tuning:
    """The law of the values as the rule tunes it, with what came of it; raises ParameterError or GainsError."""
    return tune(str(values["law.type"]), yardstick(values, robot), compile)


def yardstick(values: Values, robot: Robot) -> Yardstick:
    """v-dPBC with the values' gains along their reference, from rest; links and motors are law.start_error off it."""
    reference = config.reference(values, robot.n)
    error = np.tile(vector(values, "law.start_error", robot.n), 2)
    position = rest_position(robot, np.asarray(reference.jets(0.0))[0]) + error
    return Yardstick(robot, reference, config.gains(values, robot.n), (position, np.zeros(2 * robot.n)))


def _given(values: Values, robot: Robot, compile: bool) -> StaticLaw:
    kind = law_kind(str(values["law.type"]))
    assert kind.standard is not None
    q_0 = np.asarray(config.reference(values, robot.n).jets(0.0))[0]
    numbers = (float(values[f"law.{name}"]) for name in ("natural_frequency", "damping_ratio"))  # type: ignore[arg-type]
    return kind.make(robot, kind.standard(robot, q_0, *numbers), compile)
