# SPDX-License-Identifier: Apache-2.0
"""Perturbations of the plant that the laws do not model, each described by one number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.errors import CompareError
from fjr_core.numerics.checks import Array

from .motion_demand import MotionDemand

NOISE_BANDWIDTH = 100.0  # rad/s; velocity noise equals that of positions differentiated by a filter of this bandwidth
SMOOTHING = 0.01  # rad/s; friction changes sign within this velocity
STEEPEST = 2.0  # largest friction_rate times the step; Runge-Kutta of order 4 is stable up to 2.78
Fields = dict[str, Array]


@dataclass(frozen=True)
class Perturbation:
    """Perturbation of one kind.

    nominal: 1 for factors, else 0. lowest, highest: ends of the search for margins. first: smallest tested level above
    a nominal 0. fields: function (level, demand of the motion, integrator step [s]) -> fields of batch.Draws of a run.
    """

    name: str
    unit: str
    nominal: float
    lowest: float
    first: float
    highest: float
    fields: Callable[[float, MotionDemand, float], Fields]

    @property
    def is_factor(self) -> bool:
        """Return whether levels are factors, which may be above or below 1."""
        return self.nominal == 1.0

    def checked(self, level: float) -> float:
        """Return a valid level; raises CompareError for any other."""
        fits = level > 0 if self.is_factor else level >= 0
        if not (np.isfinite(level) and fits):
            expected = "a positive factor" if self.is_factor else f"0 or more [{self.unit}]"
            raise CompareError(f"imperfection '{self.name}' is {level}; expected {expected}")
        return float(level)


def _equal(*names: str) -> Callable[[float, MotionDemand, float], Fields]:
    """Return a function that gives the level to each of these fields."""
    return lambda level, _demand, _step: {name: np.array(level) for name in names}


def _noise(level: float, _demand: MotionDemand, _step: float) -> Fields:
    return {"position_noise": np.array(level), "velocity_noise": np.array(level * NOISE_BANDWIDTH)}


def _friction(level: float, demand: MotionDemand, step: float) -> Fields:
    """Apply Coulomb friction, half on each side of the spring, with the steepest slope that is numerically stable."""
    smoothing = max(SMOOTHING, level / 2 * demand.friction_rate * step / STEEPEST)
    return {
        "coulomb_l": level / 2 * demand.torque,
        "coulomb_m": level / 2 * demand.torque,
        "smoothing": np.array(smoothing),
    }


def numerically_stable(fields: Fields) -> Fields:
    """Return the fields of a run with smoothing adapted to reduced link inertia, which makes friction stiffer."""
    lightest = min(1.0, float(fields.get("link_inertia", 1.0)))
    return {**fields, "smoothing": fields["smoothing"] / lightest} if "smoothing" in fields else fields


def _load(level: float, demand: MotionDemand, _step: float) -> Fields:
    """Apply a constant torque to all links."""
    return {"external": level * demand.torque}


TORQUE = "of the torque of the motion"
PERTURBATIONS = {
    each.name: each
    for each in (
        Perturbation("stiffness", "times", 1.0, 1 / 30, 1.0, 30.0, _equal("stiffness")),
        Perturbation("inertia", "times", 1.0, 1 / 10, 1.0, 10.0, _equal("link_inertia", "gravity")),
        Perturbation("delay", "s", 0.0, 0.0, 5e-5, 0.1, _equal("delay")),
        Perturbation("noise", "rad", 0.0, 0.0, 1e-6, 1.0, _noise),
        Perturbation("friction", TORQUE, 0.0, 0.0, 0.01, 10.0, _friction),
        Perturbation("load", TORQUE, 0.0, 0.0, 0.01, 10.0, _load),
    )
}
"""Perturbations by their names in a comparison."""


@dataclass(frozen=True)
class Direction:
    """Direction from the nominal level of a perturbation to one end of its range; `name` is that of the margin."""

    name: str
    perturbation: Perturbation
    end: float

    def ladder(self, steps: int) -> Array:
        """Return levels (steps + 1,) from the nominal one to the end, evenly spaced on a logarithmic scale."""
        if self.perturbation.is_factor:
            return np.asarray(np.geomspace(1.0, self.end, steps + 1), dtype=float)
        return np.append(0.0, np.geomspace(self.perturbation.first, self.end, steps))


def directions(names: Sequence[str]) -> list[Direction]:
    """Return the directions of the margins of these perturbations; raises CompareError for an unknown one."""
    found = []
    for one in (known(name) for name in names):
        if one.is_factor:
            found.append(Direction(f"{one.name} down to", one, one.lowest))
        found.append(Direction(f"{one.name} up to", one, one.highest))
    return found


def known(name: str) -> Perturbation:
    """Return the perturbation of a name; raises CompareError."""
    if name not in PERTURBATIONS:
        raise CompareError(f"unknown imperfection '{name}': expected one of {', '.join(PERTURBATIONS)}")
    return PERTURBATIONS[name]
