# SPDX-License-Identifier: Apache-2.0
"""What is built from the parameters of both nodes: the controller's law and robust action, and all names.

The tables and what else is built from them are in the modules of this package, by subject; they are here again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
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
from .controller import controller_parameters
from .gains import gain_values, gains
from .law import robust
from .parameter import Parameter, Value, Values, vector
from .plant import initial_state, plant_parameters
from .reference import reference
from .robot import joints_of, robot, robot_parameters

__all__ = [
    "OwnParameters",
    "all_parameters",
    "controller_parameters",
    "gain_values",
    "gains",
    "initial_state",
    "names_of_others",
    "plant_parameters",
    "reference",
    "robot",
    "robust",
]

OwnParameters = Callable[[int], Sequence[Parameter]]
"""Makes a node's own parameters for n joints: plant_parameters or controller_parameters."""


def all_parameters(own: OwnParameters, given: Mapping[str, object]) -> list[Parameter]:
    """All parameters of a node for the given model and joints: `own` is plant_parameters or controller_parameters."""
    return [*robot_parameters(given), *own(joints_of(given))]


@cache
def names_of_others(own: OwnParameters) -> frozenset[str]:
    """Names that parameters of the other nodes have and those of `own` do not: a shared file may hold them."""
    others = {parameter.name for node in (plant_parameters, controller_parameters) for parameter in node(1)}
    return frozenset(others - {parameter.name for parameter in own(1)})


def control_law(values: Values, robot: Robot) -> StaticLaw:
    """The law of the values; raises ParameterError."""
    kind, compile = law_kind(str(values["law.type"])), bool(values["compile"])
    if kind.name == V_DPBC:
        return TrackingLaw(robot, gains(values, robot.n), compile=compile)
    try:
        return kind.make(robot, _gains(values, robot), compile)
    except GainsError as error:
        raise ParameterError(f"parameter 'law.type' is {kind.name!r}: {error}") from None


def robust_action(values: Values, law: StaticLaw) -> Robust:
    """Return the robust action of the values, for their law.

    Raises ParameterError, also where the law takes none or where integral action is too fast for robust.hold.
    """
    action = robust(values, law.robot.n)
    try:
        sampled_law(law, action)
        refuse_fast_integral(law, action)
    except GainsError as error:
        raise ParameterError(f"parameters 'robust.*' with 'law.type' {values['law.type']!r}: {error}") from None
    return action


def _gains(values: Values, robot: Robot) -> Any:
    """Gains of another law than v-dPBC: by the rule, or by the two numbers."""
    if values["law.tuned"]:
        return tuning(values).law.gains  # type: ignore[attr-defined]
    kind = law_kind(str(values["law.type"]))
    q_0 = np.asarray(reference(values, robot.n).jets(0.0))[0]
    numbers = (float(values[f"law.{name}"]) for name in ("natural_frequency", "damping_ratio"))  # type: ignore[arg-type]
    return kind.standard(robot, q_0, *numbers, _sample_period(values))


def tuning(values: Values) -> Tuning:
    """The law of the values as the rule tunes it, with what came of it; raises ParameterError or GainsError."""
    known = ("robot.", "gains.", "reference.", "law.type", "law.start_error", "law.sample_rate", "joints")
    return _tuned(tuple(sorted((name, value) for name, value in values.items() if name.startswith(known))))


@lru_cache(maxsize=8)
def _tuned(items: tuple[tuple[str, Value], ...]) -> Tuning:
    values = dict(items)
    return tune(str(values["law.type"]), yardstick(values, robot(values)))


def yardstick(values: Values, robot: Robot) -> Yardstick:
    """v-dPBC with the values' gains along their reference, from rest; links and motors are law.start_error off it."""
    motion = reference(values, robot.n)
    error = np.tile(vector(values, "law.start_error", robot.n), 2)
    position = rest_position(robot, np.asarray(motion.jets(0.0))[0]) + error
    start = position, np.zeros(2 * robot.n)
    return Yardstick(robot, motion, gains(values, robot.n), start, _sample_period(values))


def _sample_period(values: Values) -> float:
    return 1.0 / float(values["law.sample_rate"])  # type: ignore[arg-type]
