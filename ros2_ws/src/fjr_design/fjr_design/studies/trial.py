# SPDX-License-Identifier: Apache-2.0
"""Run one law on one robot along one reference with imperfections of the plant, and search its robustness margins.

Each imperfection is something that the law does not model, described by one number. Levels of friction and load are
relative to the torque that the motion requires, so that they mean the same on every robot; that demand does not depend
on the law. A margin is found by increasing an imperfection until tracking fails, and refining around that level.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.errors import ParameterError
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import inverse_dynamics
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_core.simulation.deviations import DEVIATIONS
from fjr_core.simulation.imperfections import Imperfections, friction_rate
from fjr_msgs_py.console.output import finite

from ..batch import ClosedLoop, Draws
from ..batch.draws import PARAMETERS
from .sections import number
from .sweep import REACH, figures

INSTANTS = 4096  # of the reference
CONFIGURATIONS = 16  # along it, whose inertia counts for friction
HORIZON = 60.0  # s of the reference that are evaluated, at most
STANDING = 1e-9  # rad; RMS of a reference at rest
ELEMENT = 0.3  # of the stiffness of the spring, that of a Maxwell element beside it
RIGID = 1e-9  # rad; least deflection of a spring
NOISE_BANDWIDTH = 100.0  # rad/s; velocity noise equals that of positions differentiated by a filter of this bandwidth
TRACKS = 0.1  # largest RMS error of a tracking run, relative to the RMS motion
STEPS = 16  # levels of the first scan, evenly spaced on a logarithmic scale
PARTS = 7  # levels of each refinement, between both ends of a margin
ROUNDS = 2  # of refinement


@dataclass(frozen=True)
class MotionDemand:
    """Demand of a motion.

    motion (n,) [rad]: RMS of q_ld about its mean, over time and the joints of the same unit. torque (n,) [N m]: RMS
    over time of the inverse dynamics of the rigid arm, M_l ddq_ld + C dq_ld + D_l dq_ld + grad P_l. friction_rate
    [rad/s^2]: largest imperfections.friction_rate with friction of that torque on both sides, times its smoothing.
    deflection (n,) [rad]: of the springs of the model under that torque.
    """

    motion: Array
    torque: Array
    friction_rate: float
    deflection: Array


def motion_demand(robot: Robot, reference: Reference) -> MotionDemand:
    """Return the demand of a reference; raises ParameterError for a reference at rest."""
    end = min(HORIZON, reference.end)
    jets = reference.jets(np.linspace(0.0, end, INSTANTS))
    position = jets[:, 0]
    square, units = np.var(position, axis=0), np.array([unit.position for unit in robot.units])
    motion = np.sqrt([np.mean(square[units == unit]) for unit in units])
    if len(still := units[motion <= STANDING]):
        raise ParameterError(f"the reference is at rest for {end:g} s at all joints in {still[0]}; expected a motion")
    tau, *_ = inverse_dynamics(robot)(*jets.transpose(1, 2, 0))
    torque = np.sqrt(np.mean(tau.full() ** 2, axis=1))
    friction = Imperfections(robot.n, coulomb_l=torque, coulomb_m=torque, smoothing=1.0)
    rates = [friction_rate(friction, robot.M_l(q_l), robot.M_m) for q_l in position[:: INSTANTS // CONFIGURATIONS]]
    return MotionDemand(motion, torque, max(rates), robot.deflection(torque))


@dataclass(frozen=True)
class Imperfection:
    """Imperfection of one kind; `fields_of` says what it changes.

    nominal: 1 for factors, else 0. lowest, highest: ends of the search for margins. first: smallest tested level above
    a nominal 0. heading, axis: of its plot.
    """

    name: str
    unit: str
    nominal: float
    lowest: float
    first: float
    highest: float
    heading: str
    axis: str

    @property
    def is_factor(self) -> bool:
        """Return whether levels are factors, which may be above or below 1."""
        return self.nominal == 1.0

    @property
    def scale(self) -> float:
        """Return the factor from a level to its number on the axis: of factors 1, else to ms, mrad or %."""
        return 1.0 if self.is_factor else 1e3 if self.unit in ("s", "rad") else 100.0

    def read(self, key: str, given: Any) -> float:
        """Return a level of a suite; raises ParameterError for one that is not valid."""
        level = number(key, given)
        if not (level > 0 if self.is_factor else level >= 0):
            expected = "a positive factor" if self.is_factor else f"0 or more [{self.unit}]"
            raise ParameterError(f"has {level} as '{key}'; expected {expected}")
        return level


TORQUE, SHARE = "of the torque of the motion", "[% of the motion's torque]"
IMPERFECTIONS = {
    each.name: each
    for each in (
        Imperfection("stiffness", "times", 1.0, 1 / 30, 1.0, 30.0, "Wrong stiffness", "true stiffness / the model's"),
        Imperfection("inertia", "times", 1.0, 0.1, 1.0, 10.0, "Wrong masses", "true inertia and weight / the model's"),
        Imperfection("delay", "s", 0.0, 0.0, 5e-5, 0.1, "Command delay", "delay [ms]"),
        Imperfection("noise", "rad", 0.0, 0.0, 1e-6, 1.0, "Noise", "noise of the positions [mrad]"),
        Imperfection("friction", TORQUE, 0.0, 0.0, 0.01, 10.0, "Unknown friction", f"friction {SHARE}"),
        Imperfection("load", TORQUE, 0.0, 0.0, 0.01, 10.0, "Unknown load", f"load {SHARE}"),
        Imperfection("hardening", TORQUE, 0.0, 0.0, 0.01, 10.0, "Hardening springs", f"hardening {SHARE}"),
        Imperfection("hysteresis", TORQUE, 0.0, 0.0, 0.01, 10.0, "Springs with hysteresis", f"hysteresis {SHARE}"),
    )
}
"""Imperfections by their names in a comparison."""


def imperfection(name: str) -> Imperfection:
    """Return the imperfection of a name; raises ParameterError."""
    if name not in IMPERFECTIONS:
        raise ParameterError(f"unknown imperfection '{name}': expected one of {', '.join(IMPERFECTIONS)}")
    return IMPERFECTIONS[name]


def fields_of(levels: Mapping[str, float], demand: MotionDemand, step: float) -> dict[str, Array]:
    """Return the fields of Draws of a run with all these imperfections, by their names; raises ParameterError.

    Friction acts half on each side of the springs, with the steepest slope that is stable with this integrator step
    [s]; reduced link inertia makes it stiffer. The load is a constant torque on all links. Hardening adds its share of
    the torque of the motion at the deflection under that torque, a Maxwell element (nonideal_plant) slips at its share.
    """
    fields: dict[str, Array] = {}
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
    """Return the directions of the margins of these imperfections; raises ParameterError for an unknown one."""
    found = []
    for one in (imperfection(name) for name in names):
        if one.is_factor:
            found.append(Direction(f"{one.name} down to", one, one.lowest))
        found.append(Direction(f"{one.name} up to", one, one.highest))
    return found


@dataclass(frozen=True)
class RobustnessMargin:
    """Margin in one direction.

    level: largest level such that it and all tested levels below track; None if the nominal one does not. beyond: the
    next tested level, which does not track; None if all levels track.
    """

    level: float | None
    beyond: float | None


def margin(direction: Direction, track: Callable[[Sequence[float]], NDArray[np.bool_]]) -> RobustnessMargin:
    """Return the margin in a direction.

    track: returns whether the run at each of k levels tracks (k,). The search stops at the first level that fails;
    larger levels that track again are ignored, because a robot may have any level in between.
    """
    levels = direction.ladder(STEPS).tolist()
    for _ in range(1 + ROUNDS):
        failed = [*track(levels), False].index(False)
        if failed in (0, len(levels)):
            return RobustnessMargin(levels[-1] if failed else None, None if failed else levels[0])
        ends = levels[failed - 1], levels[failed]
        levels = (np.geomspace if ends[0] else np.linspace)(*ends, PARTS + 2).tolist()
    return RobustnessMargin(*ends)


Metrics = dict[str, Any]
"""Metrics of one run over all joints, by name; errors count after settle_after, see Outcomes.

rms [rad]: RMS over time and joints of q_l - q_ld; relative: the same, every joint divided by the motion of its
MotionDemand. peak [rad]: of the worst joint. settling [s]. effort_rms [N m]: over time and joints; effort_peak [N m]:
of any joint. power [W]: mean of |u' B_m' dq_m|. steady [rad]: mean error of the worst joint over the last second. All
are None for a run that is not stable. stopped: the limit that stopped the controller, None if none did; such a run does
not track.
"""


@dataclass
class Trial:
    """Closed loop with the demand of its motion.

    effort_limit (n,) [N m]: saturation of commands; inf: none. tracks: a run tracks if it is stable and its RMS error
    relative to the motion is at most this number; the same for all laws. All runs have the same noise.
    evaluated: (imperfection, level) of all runs so far -> metrics.
    """

    loop: ClosedLoop
    demand: MotionDemand
    effort_limit: ArrayLike = np.inf
    tracks: float = TRACKS
    evaluated: dict[tuple[str, float], Metrics] = field(default_factory=dict)

    def metrics(self, runs: Sequence[Mapping[str, float]]) -> list[Metrics]:
        """Return the metrics of one run per item: levels by the names of IMPERFECTIONS, {} for the nominal plant."""
        outcomes = self.loop.run(self.draws(runs))
        of = figures(outcomes, outcomes.stable)
        relative = np.sqrt(np.mean(np.square(outcomes.rms / self.demand.motion), axis=1))
        running = outcomes.stable & (outcomes.cause == "")
        values = {"rms": of["rms"], "relative": relative, "peak": of["peak"], "settling": outcomes.settling}
        values |= {name: of[name] for name in ("effort_rms", "effort_peak", "power")} | {"steady": of["final"]}
        return [
            {
                "stable": stable,
                "tracks": bool(running[i] and relative[i] <= self.tracks),
                **{name: finite(value[i]) if stable else None for name, value in values.items()},
                "stopped": str(outcomes.cause[i]) or None if stable else None,
            }
            for i, stable in enumerate(outcomes.stable.tolist())
        ]

    def margins(self, directions: Sequence[Direction]) -> dict[str, RobustnessMargin]:
        """Return the largest level in each direction up to which the loop tracks, by the names of the directions."""
        return {each.name: margin(each, partial(self._track, each.imperfection.name)) for each in directions}

    def curve(self, imperfection: str) -> tuple[Array, list[Metrics]]:
        """Return all evaluated levels of an imperfection in increasing order, with their metrics."""
        levels = sorted(level for name, level in self.evaluated if name == imperfection)
        return np.array(levels), [self.evaluated[imperfection, level] for level in levels]

    def draws(self, runs: Sequence[Mapping[str, float]]) -> Draws:
        """Return the draws of runs with these imperfections; fields that none of them changes are nominal."""
        n, step = self.loop.robot.n, self.loop.sample_period / self.loop.inner_steps
        fields = [fields_of(levels, self.demand, step) for levels in runs]
        columns = {}
        for name in {name for each in fields for name in each}:
            nominal = np.full(() if PARAMETERS[name].per_run else n, PARAMETERS[name].nominal)
            columns[name] = np.stack([np.broadcast_to(each.get(name, nominal), nominal.shape) for each in fields])
        limit = np.broadcast_to(self.effort_limit, (len(runs), n))
        return Draws(len(runs), seed=0, effort_limit=limit, **columns)

    def _track(self, name: str, levels: Sequence[float]) -> NDArray[np.bool_]:
        new = [level for level in levels if (name, level) not in self.evaluated]
        for level, cell in zip(new, self.metrics([{name: level} for level in new]) if new else [], strict=True):
            self.evaluated[name, level] = cell
        return np.array([self.evaluated[name, level]["tracks"] for level in levels])
