# SPDX-License-Identifier: Apache-2.0
"""The controller's law as its parameters describe it: v-dPBC, or one of those that it is compared with."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from ..control.registry import V_DPBC, law_kind
from ..control.robust import Robust, sampled_law
from ..control.static_law import StaticLaw
from ..control.vdpbc.law import TrackingLaw
from ..errors import GainsError, ParameterError
from ..robot.robot import Robot
from ..stability.integral_bound import refuse_fast_integral
from ..stability.linearization import rest_position
from ..tuning.bandwidth import Yardstick
from ..tuning.equal_bandwidth import Tuning, tune
from . import builders
from .parameter import Value, Values, vector


def control_law(values: Values, robot: Robot) -> StaticLaw:
    """The law of the values; raises ParameterError."""
    kind, compile = law_kind(str(values["law.type"])), bool(values["compile"])
    if kind.name == V_DPBC:
        return TrackingLaw(robot, builders.gains(values, robot.n), compile=compile)
    try:
        return kind.make(robot, _gains(values, robot), compile)
    except GainsError as error:
        raise ParameterError(f"parameter 'law.type' is {kind.name!r}: {error}") from None


def robust_action(values: Values, law: StaticLaw) -> Robust:
    """Return the robust action of the values, for their law.

    Raises ParameterError, also where the law takes none or where integral action is too fast for robust.hold.
    """
    robust = builders.robust(values, law.robot.n)
    try:
        sampled_law(law, robust)
        refuse_fast_integral(law, robust)
    except GainsError as error:
        raise ParameterError(f"parameters 'robust.*' with 'law.type' {values['law.type']!r}: {error}") from None
    return robust


def _gains(values: Values, robot: Robot) -> Any:
    """Gains of another law than v-dPBC: by the rule, or by the two numbers."""
    if values["law.tuned"]:
        return tuning(values).law.gains  # type: ignore[attr-defined]
    kind = law_kind(str(values["law.type"]))
    q_0 = np.asarray(builders.reference(values, robot.n).jets(0.0))[0]
    numbers = (float(values[f"law.{name}"]) for name in ("natural_frequency", "damping_ratio"))  # type: ignore[arg-type]
    return kind.standard(robot, q_0, *numbers, _sample_period(values))


def tuning(values: Values) -> Tuning:
    """The law of the values as the rule tunes it, with what came of it; raises ParameterError or GainsError."""
    known = ("robot.", "gains.", "reference.", "law.type", "law.start_error", "law.sample_rate", "joints")
    return _tuned(tuple(sorted((name, value) for name, value in values.items() if name.startswith(known))))


@lru_cache(maxsize=8)
def _tuned(items: tuple[tuple[str, Value], ...]) -> Tuning:
    values = dict(items)
    return tune(str(values["law.type"]), yardstick(values, builders.robot(values)))


def yardstick(values: Values, robot: Robot) -> Yardstick:
    """v-dPBC with the values' gains along their reference, from rest; links and motors are law.start_error off it."""
    reference = builders.reference(values, robot.n)
    error = np.tile(vector(values, "law.start_error", robot.n), 2)
    position = rest_position(robot, np.asarray(reference.jets(0.0))[0]) + error
    start = position, np.zeros(2 * robot.n)
    return Yardstick(robot, reference, builders.gains(values, robot.n), start, _sample_period(values))


def _sample_period(values: Values) -> float:
    return 1.0 / float(values["law.sample_rate"])  # type: ignore[arg-type]
