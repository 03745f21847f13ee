# SPDX-License-Identifier: Apache-2.0
"""Build the objects that the parameters of both nodes describe: control law, robust action.

The other builders are in the modules of their parameters and are imported here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from ..errors import FjrError, GainsError, ParameterError
from ..files import other_package
from ..files.python_class import is_named
from ..law.python_law import own_law
from ..law.registry import V_DPBC, LawKind, law_kind
from ..law.robust import Robust, sampled_law
from ..law.static_law import StaticLaw
from ..law.vdpbc.law import TrackingLaw
from ..model.robot import Robot
from ..stability.integral_bound import refuse_fast_integral
from . import law
from .controller import controller_parameters
from .gains import gain_values as gain_values
from .gains import gains
from .law import robust
from .parameter import Parameter, Values, number
from .plant import initial_state as initial_state
from .plant import plant as plant
from .plant import plant_parameters
from .reference import reference
from .robot import joints_of, robot_parameters
from .robot import robot as robot
from .safety import with_robot
from .user_options import is_option, option_parameters, options

OwnParameters = Callable[[int], Sequence[Parameter]]
"""Makes a node's own parameters for n joints: plant_parameters or controller_parameters."""


def all_parameters(own: OwnParameters, given: Mapping[str, object], user_code: bool = True) -> list[Parameter]:
    """Return all parameters of a node for the given model and joints: those of the robot, its `own`, and options.

    user_code: import the classes of the user that the values name; false: leave out their options.
    """
    parameters = own(joints_of(given))
    of_user = option_parameters(parameters, given) if user_code else ()
    return [*robot_parameters(given), *with_robot(parameters, given), *of_user]


def is_of_others(own: OwnParameters, name: str) -> bool:
    """Return whether only other nodes declare a parameter of this name; a shared parameter file may contain it."""
    mine, others = _tables(own)
    return name not in {each.name for each in mine} and (
        name in {each.name for each in others} or is_option(others, name)
    )


def names_of_others(own: OwnParameters) -> set[str]:
    """Return the names of the parameters that only other nodes declare, without options of classes of the user."""
    return {each.name for each in _tables(own)[1]}


def without_others(own: OwnParameters, merged: Mapping[str, object], given: Mapping[str, object]) -> dict[str, object]:
    """Return merged values without those of a robot file that only other nodes declare, such as imperfections.*."""
    return {name: value for name, value in merged.items() if name in given or not is_of_others(own, name)}


@cache
def _tables(own: OwnParameters) -> tuple[tuple[Parameter, ...], tuple[Parameter, ...]]:
    """Return the parameters of one joint of the node with this table, and those that only other nodes have."""
    mine = tuple(own(1))
    names = {parameter.name for parameter in mine}
    both = (parameter for node in (plant_parameters, controller_parameters) for parameter in node(1))
    return mine, tuple(parameter for parameter in both if parameter.name not in names)


def control_law(values: Values, robot: Robot) -> StaticLaw:
    """Return the control law of the values; raises ParameterError."""
    name, compile = str(values[law.TYPE.name]), bool(values["compile"])
    if is_named(name):
        return _own_law(values, robot)
    kind = law_kind(name)
    if kind.name == V_DPBC:
        return TrackingLaw(robot, gains(values, robot.n), compile=compile)
    try:
        return kind.make(robot, _baseline_gains(values, robot), compile)
    except GainsError as error:
        raise ParameterError(f"parameter '{law.TYPE.name}' is {kind.name!r}: {error}") from None


def _own_law(values: Values, robot: Robot) -> StaticLaw:
    """Return the law of the class that law.type names, with law.options.*; raises ParameterError."""
    name = str(values[law.TYPE.name])
    try:
        return own_law(name, robot, options(law.TYPE, values), compile=bool(values["compile"]))
    except FjrError as error:
        raise ParameterError(f"parameter '{law.TYPE.name}' is {name!r}: {error}") from None


def robust_action(values: Values, static_law: StaticLaw) -> Robust:
    """Return the robust action of the values for their law.

    Raises ParameterError, also if the law supports none or the integral action is too fast for robust.hold.
    """
    action = robust(values, static_law.robot.n)
    try:
        sampled_law(static_law, action)
        refuse_fast_integral(static_law, action)
    except GainsError as error:
        raise ParameterError(
            f"parameters 'robust.*' with '{law.TYPE.name}' {values[law.TYPE.name]!r}: {error}"
        ) from None
    return action


def _baseline_gains(values: Values, robot: Robot) -> Any:
    """Return the gains of a baseline: tuned, or of law.natural_frequency and law.damping_ratio; law.gain_factors."""
    kind, factors = law_kind(str(values[law.TYPE.name])), np.asarray(values[law.GAIN_FACTORS.name])
    return kind.scaled_gains(_rule_gains(values, robot, kind), factors)


def _rule_gains(values: Values, robot: Robot, kind: LawKind) -> Any:
    if values[law.TUNED.name]:
        return other_package.module("fjr_design.tuning.scenario_target").tuning(values).law.gains
    q_0 = np.asarray(reference(values, robot.n).jets(0.0))[0]
    frequency, damping = number(values, law.NATURAL_FREQUENCY.name), number(values, law.DAMPING_RATIO.name)
    return kind.standard(robot, q_0, frequency, damping, sample_period(values))


def sample_period(values: Values) -> float:
    """Return the sample period of the law [s]."""
    return 1.0 / number(values, law.SAMPLE_RATE.name)
