# SPDX-License-Identifier: Apache-2.0
"""Coordinates of a search of gains: logarithms of factors on parameters of the controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fjr_core.config import law as law_parameters
from fjr_core.config.controller import OBSERVER_BANDWIDTH, observer
from fjr_core.config.law import ROBUST, control_law, gain_values, robust_action
from fjr_core.config.scenario import Scenario
from fjr_core.errors import ParameterError
from fjr_core.extensions.law_registry import V_DPBC, law_kind
from fjr_core.files.importing import is_named
from fjr_core.law.interfaces import SampledLaw
from fjr_core.robust.law import sampled_law
from fjr_core.robust.options import GAINS as ROBUST_GAINS
from fjr_core.runtime.velocity_observer import VelocityObserver

from ..tuning.equal_bandwidth import baseline_target, tune, tuning

SCENARIO, RULE = "scenario", "rule"
"""Starts of a search: the gains of the scenario, those of the rule of equal bandwidth, which v-dPBC can have."""


@dataclass(frozen=True)
class Coordinate:
    """Logarithm of a factor on a parameter of the controller, or on one entry of it; title: of the scaled gain."""

    parameter: str
    entry: int | None = None
    title: str = ""

    @property
    def name(self) -> str:
        """Name for readers."""
        return self.title or self.parameter


@dataclass(frozen=True, eq=False)
class SearchCoordinates:
    """Search space of a scenario's law around its start, the origin; every point is a set of parameter values.

    v-dPBC: a factor on each gain. Another law: its natural frequency, its damping ratio and law.gain_factors. Each
    robust gain that is enabled in the scenario, and the bandwidth of its velocity observer. start: parameter values at
    the origin. Create it by `coordinates`.
    """

    scenario: Scenario
    start: Mapping[str, Any]
    axes: tuple[Coordinate, ...]

    def __len__(self) -> int:
        return len(self.axes)

    def values(self, z: ArrayLike) -> dict[str, Any]:
        """Return the parameter values at a point z (d,), with the types that a parameter file requires."""
        entries = {name: np.atleast_1d(np.asarray(value, dtype=object)) for name, value in self.start.items()}
        for axis, log in zip(self.axes, np.asarray(z, dtype=float), strict=True):
            scaled = entries[axis.parameter].copy()
            scaled[slice(None) if axis.entry is None else axis.entry] *= float(np.exp(log))
            entries[axis.parameter] = scaled
        is_list = {name: isinstance(value, (tuple, list)) for name, value in self.start.items()}
        return {name: each.tolist() if is_list[name] else each[0] for name, each in entries.items()}

    def controller(self, z: ArrayLike) -> tuple[SampledLaw, VelocityObserver | None]:
        """Return law and observer at a point; raises FjrError if no such gains exist."""
        own = {name: tuple(value) if isinstance(value, list) else value for name, value in self.values(z).items()}
        values = {**self.scenario.controller_values, **own}
        law = control_law(values, self.scenario.robot)
        return sampled_law(law, robust_action(values, law)), observer(values, self.scenario.robot)


def coordinates(scenario: Scenario, start: str = SCENARIO) -> SearchCoordinates:
    """Return the search space of a scenario's law around one of its starts.

    Raises ParameterError for a law of the user, GainsError if the rule of equal bandwidth has no stable gains.
    """
    values, name = scenario.controller_values, str(scenario.controller_values[law_parameters.TYPE.name])
    if is_named(name):
        raise ParameterError(f"parameter 'law.type' is {name!r}; expected a law of fjr_core, whose gains can be tuned")
    origin, axes = _v_dpbc(scenario, start) if name == V_DPBC else _by_rule(scenario, name)
    for option in ROBUST_GAINS:
        parameter = ROBUST[option].name
        if np.any(values[parameter]):
            origin[parameter] = values[parameter]
            axes.append(Coordinate(parameter))
    if scenario.sensing.bandwidth is not None:
        origin[OBSERVER_BANDWIDTH.name] = values[OBSERVER_BANDWIDTH.name]
        axes.append(Coordinate(OBSERVER_BANDWIDTH.name))
    return SearchCoordinates(scenario, origin, tuple(axes))


def _v_dpbc(scenario: Scenario, start: str) -> tuple[dict[str, Any], list[Coordinate]]:
    gains = scenario.gains
    if start == RULE:
        gains = tune(V_DPBC, baseline_target(scenario), retune=True).law.gains
    given = gain_values(gains, scenario.robot.n)
    scaled = [f"gains.{gain}" for gain in law_kind(V_DPBC).scaled]
    return {name: tuple(given[name]) for name in scaled}, [Coordinate(name) for name in scaled]


def _by_rule(scenario: Scenario, name: str) -> tuple[dict[str, Any], list[Coordinate]]:
    """Return the coordinates of a law with a tuning rule; it starts at the gains that it has in the scenario."""
    values, p = scenario.controller_values, law_parameters
    numbers = (p.NATURAL_FREQUENCY.name, p.DAMPING_RATIO.name)
    tuned = bool(values[p.TUNED.name])
    found = tuning(values) if tuned else None
    start: dict[str, Any] = {p.TYPE.name: name, p.TUNED.name: False}
    start |= dict(zip(numbers, (found.omega, found.damping), strict=True)) if found else {k: values[k] for k in numbers}
    axes = [Coordinate(number) for number in numbers]
    if scaled := law_kind(name).scaled:
        factors = np.broadcast_to(np.asarray(values[p.GAIN_FACTORS.name]), len(scaled))
        start[p.GAIN_FACTORS.name] = tuple(float(factor) for factor in factors)
        axes += [Coordinate(p.GAIN_FACTORS.name, i, f"factor of {gain}") for i, gain in enumerate(scaled)]
    return start, axes
