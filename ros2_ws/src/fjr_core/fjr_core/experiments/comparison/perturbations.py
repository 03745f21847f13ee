# SPDX-License-Identifier: Apache-2.0
"""The ways in which a compared plant departs from what the laws believe, each one number on one axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import CompareError
from ...numerics.checks import Array
from .motion_demand import Needs

NOISE_BANDWIDTH = 100.0  # rad/s: velocities are as noisy as if a filter of this bandwidth had differentiated positions
SMOOTHING = 0.01  # rad/s: friction turns its sign over so small a velocity
STEEPEST = 2.0  # of 2.78: a Runge-Kutta step of order 4 times the rate of creeping friction; see friction_rate
Fields = dict[str, Array]


@dataclass(frozen=True)
class Axis:
    """One imperfection. nominal: 1 for factors, else 0; lowest, highest: the ends of the search for margins.

    first: the smallest level above a nominal 0 that is looked at. fields: (level, needs of the motion, integrator
    step [s]) -> fields of campaign.Draws of one run.
    """

    name: str
    unit: str
    nominal: float
    lowest: float
    first: float
    highest: float
    fields: Callable[[float, Needs, float], Fields]

    @property
    def is_factor(self) -> bool:
        """Whether levels are factors, with two signs of an error."""
        return self.nominal == 1.0

    def checked(self, level: float) -> float:
        """The level, if this axis has such a one; raises CompareError."""
        fits = level > 0 if self.is_factor else level >= 0
        if not (np.isfinite(level) and fits):
            wanted = "a positive factor" if self.is_factor else f"0 or more [{self.unit}]"
            raise CompareError(f"imperfection '{self.name}' is {level}; expected {wanted}")
        return float(level)


def _stiffness(level: float, _needs: Needs, _step: float) -> Fields:
    return {"stiffness": np.array(level)}


def _inertia(level: float, _needs: Needs, _step: float) -> Fields:
    """Masses: inertia and weight of the links by one factor."""
    return {name: np.array(level) for name in ("link_inertia", "gravity")}


def _delay(level: float, _needs: Needs, _step: float) -> Fields:
    return {"delay": np.array(level)}


def _noise(level: float, _needs: Needs, _step: float) -> Fields:
    return {"position_noise": np.array(level), "velocity_noise": np.array(level * NOISE_BANDWIDTH)}


def _friction(level: float, needs: Needs, step: float) -> Fields:
    """Coulomb friction, half of it on either side of the spring, as steep about rest as the integrator bears."""
    smoothing = max(SMOOTHING, level / 2 * needs.friction_rate * step / STEEPEST)
    return {
        "coulomb_l": level / 2 * needs.torque,
        "coulomb_m": level / 2 * needs.torque,
        "smoothing": np.array(smoothing),
    }


def bearable(fields: Fields) -> Fields:
    """The fields of a run with several imperfections: lighter links make friction steeper about rest."""
    lightest = min(1.0, float(fields.get("link_inertia", 1.0)))
    return {**fields, "smoothing": fields["smoothing"] / lightest} if "smoothing" in fields else fields


def _load(level: float, needs: Needs, _step: float) -> Fields:
    """A constant torque on all links."""
    return {"external": level * needs.torque}


TORQUE = "of the torque of the motion"
AXES = {
    axis.name: axis
    for axis in (
        Axis("stiffness", "times", 1.0, 1 / 30, 1.0, 30.0, _stiffness),
        Axis("inertia", "times", 1.0, 1 / 10, 1.0, 10.0, _inertia),
        Axis("delay", "s", 0.0, 0.0, 5e-5, 0.1, _delay),
        Axis("noise", "rad", 0.0, 0.0, 1e-6, 1.0, _noise),
        Axis("friction", TORQUE, 0.0, 0.0, 0.01, 10.0, _friction),
        Axis("load", TORQUE, 0.0, 0.0, 0.01, 10.0, _load),
    )
}
"""Imperfections by their names in a suite."""


@dataclass(frozen=True)
class Direction:
    """From the nominal level of an axis to one end; `name` is what a margin there is called."""

    name: str
    axis: Axis
    end: float

    def ladder(self, steps: int) -> Array:
        """Levels (steps + 1,) from the nominal one to the end, evenly on a logarithmic scale."""
        if self.axis.is_factor:
            return np.asarray(np.geomspace(1.0, self.end, steps + 1), dtype=float)
        return np.append(0.0, np.geomspace(self.axis.first, self.end, steps))


def directions(names: Sequence[str]) -> list[Direction]:
    """What margins are searched for on these axes; raises CompareError for an unknown one."""
    found = []
    for axis in (known(name) for name in names):
        if axis.is_factor:
            found.append(Direction(f"{axis.name} down to", axis, axis.lowest))
        found.append(Direction(f"{axis.name} up to", axis, axis.highest))
    return found


def known(name: str) -> Axis:
    """The axis of a name; raises CompareError."""
    if name not in AXES:
        raise CompareError(f"unknown imperfection '{name}': expected one of {', '.join(AXES)}")
    return AXES[name]
