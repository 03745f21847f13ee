# SPDX-License-Identifier: Apache-2.0
"""Imperfections of the plant that the laws of a comparison do not model, each described by one number.

Levels of friction and load are relative to the torque that the motion requires, so that they mean the same on every
robot; that demand does not depend on the law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from fjr_core.errors import CompareError
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import spring_torque
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_core.simulation.deviations import DEVIATIONS
from fjr_core.simulation.imperfections import Imperfections, friction_rate

from .sweep import REACH

INSTANTS = 4096
CONFIGURATIONS = 16
HORIZON = 60.0  # s of the reference that are evaluated, at most
STANDING = 1e-9  # rad; RMS of a reference at rest
ELEMENT = 0.3  # of the stiffness of the spring, that of a Maxwell element beside it
RIGID = 1e-9  # rad; least deflection of a spring
NOISE_BANDWIDTH = 100.0  # rad/s; velocity noise equals that of positions differentiated by a filter of this bandwidth
Fields = dict[str, Array]


@dataclass(frozen=True)
class MotionDemand:
    """Demand of a motion.

    motion [rad]: RMS of q_ld about its mean, over time and joints. torque (n,) [N m]: RMS over time of the inverse
    dynamics of the rigid arm, M_l ddq_ld + C dq_ld + D_l dq_ld + grad P_l. friction_rate [rad/s^2]: largest
    imperfections.friction_rate with friction of that torque on both sides, times its smoothing. deflection (n,) [rad]:
    of the springs of the model under that torque.
    """

    motion: float
    torque: Array
    friction_rate: float
    deflection: Array


def motion_demand(robot: Robot, reference: Reference) -> MotionDemand:
    """Return the demand of a reference; raises CompareError for a reference at rest."""
    end = min(HORIZON, reference.end)
    jets = reference.jets(np.linspace(0.0, end, INSTANTS))
    position = jets[:, 0]
    motion = float(np.sqrt(np.mean((position - position.mean(axis=0)) ** 2)))
    if not motion > STANDING:
        raise CompareError(f"the reference is at rest for {end:g} s; expected a motion")
    symbols = [ca.SX.sym(name, robot.n) for name in ("q_l", "dq_l", "ddq_l")]
    inverse_dynamics = ca.Function("inverse_dynamics", symbols, [ca.densify(spring_torque(robot, *symbols))])
    torques = inverse_dynamics.map(INSTANTS)(*(jets[:, row].T for row in range(3))).full()
    torque = np.sqrt(np.mean(torques**2, axis=1))
    friction = Imperfections(robot.n, coulomb_l=torque, coulomb_m=torque, smoothing=1.0)
    rates = [friction_rate(friction, robot.M_l(q_l), robot.M_m) for q_l in position[:: INSTANTS // CONFIGURATIONS]]
    return MotionDemand(motion, torque, max(rates), robot.deflection(torque))


@dataclass(frozen=True)
class Imperfection:
    """Imperfection of one kind; `fields_of` says what it changes.

    nominal: 1 for factors, else 0. lowest, highest: ends of the search for margins. first: smallest tested level above
    a nominal 0.
    """

    name: str
    unit: str
    nominal: float
    lowest: float
    first: float
    highest: float

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


TORQUE = "of the torque of the motion"
IMPERFECTIONS = {
    each.name: each
    for each in (
        Imperfection("stiffness", "times", 1.0, 1 / 30, 1.0, 30.0),
        Imperfection("inertia", "times", 1.0, 1 / 10, 1.0, 10.0),
        Imperfection("delay", "s", 0.0, 0.0, 5e-5, 0.1),
        Imperfection("noise", "rad", 0.0, 0.0, 1e-6, 1.0),
        Imperfection("friction", TORQUE, 0.0, 0.0, 0.01, 10.0),
        Imperfection("load", TORQUE, 0.0, 0.0, 0.01, 10.0),
        Imperfection("hardening", TORQUE, 0.0, 0.0, 0.01, 10.0),
        Imperfection("hysteresis", TORQUE, 0.0, 0.0, 0.01, 10.0),
    )
}
"""Imperfections by their names in a comparison."""


def imperfection(name: str) -> Imperfection:
    """Return the imperfection of a name; raises CompareError."""
    if name not in IMPERFECTIONS:
        raise CompareError(f"unknown imperfection '{name}': expected one of {', '.join(IMPERFECTIONS)}")
    return IMPERFECTIONS[name]


def fields_of(levels: Mapping[str, float], demand: MotionDemand, step: float) -> Fields:
    """Return the fields of Draws of a run with all these imperfections, by their names; raises CompareError.

    Friction acts half on each side of the springs, with the steepest slope that is stable with this integrator step
    [s]; reduced link inertia makes it stiffer. The load is a constant torque on all links. Hardening adds its share of
    the torque of the motion at the deflection under that torque, a Maxwell element (nonideal_plant) slips at its share.
    """
    fields: Fields = {}
    for name, level in levels.items():
        match imperfection(name).name:
            case "inertia":
                fields |= {"link_inertia": np.array(level), "gravity": np.array(level)}
            case "noise":
                fields |= {"position_noise": np.array(level), "velocity_noise": np.array(level * NOISE_BANDWIDTH)}
            case "friction":
                half = level / 2 * demand.torque
                smoothing = max(DEVIATIONS["smoothing"].nominal, level / 2 * demand.friction_rate * step / REACH)
                smoothing /= min(1.0, levels.get("inertia", 1.0))
                fields |= {"coulomb_l": half, "coulomb_m": half, "smoothing": np.array(smoothing)}
            case "load":
                fields["link_torque"] = level * demand.torque
            case "hardening":
                fields["cubic"] = level * demand.torque / np.maximum(demand.deflection, RIGID) ** 3
            case "hysteresis":
                slip = np.maximum(level * demand.deflection / ELEMENT, RIGID)
                fields |= {"hysteresis": level * demand.torque, "slip": slip}
            case same:
                fields[same] = np.array(level)
    return fields


@dataclass(frozen=True)
class Direction:
    """Direction from the nominal level of an imperfection to one end of its range; `name` is that of the margin."""

    name: str
    imperfection: Imperfection
    end: float

    @property
    def is_down(self) -> bool:
        """Return whether smaller levels are farther from the nominal one."""
        return self.end < self.imperfection.nominal

    def ladder(self, steps: int) -> Array:
        """Return levels (steps + 1,) from the nominal one to the end, evenly spaced on a logarithmic scale."""
        if self.imperfection.is_factor:
            return np.asarray(np.geomspace(1.0, self.end, steps + 1), dtype=float)
        return np.append(0.0, np.geomspace(self.imperfection.first, self.end, steps))


def directions(names: Sequence[str]) -> list[Direction]:
    """Return the directions of the margins of these imperfections; raises CompareError for an unknown one."""
    found = []
    for one in (imperfection(name) for name in names):
        if one.is_factor:
            found.append(Direction(f"{one.name} down to", one, one.lowest))
        found.append(Direction(f"{one.name} up to", one, one.highest))
    return found
