# SPDX-License-Identifier: Apache-2.0
"""What an identification knows about a robot: intervals and verdicts, a posterior, and plants drawn from it.

The posterior is normal in the coordinates of its parameters, so that every draw is a linear function of standard normal
numbers z: theta = mean + S z with S S = covariance. z comes from a random generator that counts the draws, so that a
run draws the same plant whichever runs accompany it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.errors import ParameterError
from fjr_core.files.text_file import read_text
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array, is_diagonal
from fjr_core.simulation.deviations import DEVIATIONS, POINT, Deviation
from fjr_design.batch import draws
from fjr_design.batch.draws import LOG_NORMAL, NORMAL, Distribution, DrawnColumn

from .drawn_loops import DrawnPlants

IDENTIFIED, WEAK, UNKNOWN = "identified", "weakly identified", "not identifiable"
LOG, NONNEGATIVE, LINEAR, SQUARE = "log", "non-negative", "linear", "square"
"""Coordinates of a parameter in the posterior: its logarithm, itself, clipped at 0 or not, its square, clipped at 0."""
DEFLECTION = "deflection"  # signal q_m - q_l of a fit that follows from the motion
MATRICES = {one.parameter: one.matrix for one in DEVIATIONS.values() if one.matrix}
"""Matrices of a robot whose diagonals are drawn, by the name of their parameter in an identification."""
NAMES = {one.parameter: one for one in DEVIATIONS.values() if one.parameter}
"""The glossary of deviations, by their names in an identification."""
DELAY, CUBIC = "effort_delay", "cubic"
LEAST = 1e-3  # of the robot's own value; smallest drawn stiffness and motor inertia
STREAM = "posterior"
SAMPLES = 4096  # for the marginal of a difference
WHOLE = 8.0  # standard deviations, beyond which one draw in 10^15 is


def natural(z: Array, coordinate: str) -> Array:
    """Return parameter values of their coordinates."""
    if coordinate == LOG:
        return np.exp(np.minimum(z, 700.0))  # finite also where nothing determines a parameter
    return z if coordinate == LINEAR else np.maximum(z, 0.0) ** (0.5 if coordinate == SQUARE else 1.0)


@dataclass(frozen=True)
class Estimate:
    """One parameter of one joint: value, 95 % interval (low, high), prior value, verdict and its reason.

    name: joint_stiffness [N m/rad], motor_inertia [kg m^2], link_damping, motor_damping [N m s/rad],
    link_coulomb_friction, motor_coulomb_friction, link_static_friction, motor_static_friction [N m], stribeck_velocity
    [rad/s], link_load_friction, motor_load_friction [1], offset [rad] (of q_m - q_l at zero spring torque), link_skew,
    torque_skew, effort_delay, actuator_lag [s], gear_ratio_error [1], payload_mass [kg], payload_position_x, _y, _z
    [m], position_torque_sin1, _cos1, _sin2, _cos2 [N m]. joint: "" for the whole arm. An UNKNOWN parameter keeps its
    prior; reason: what would reveal it. deflections [rad]: range it was seen in. at_least: its bound if UNKNOWN, 0:
    none.
    """

    name: str
    joint: str
    unit: str
    value: float
    low: float
    high: float
    prior: float
    verdict: str
    reason: str = ""
    deflections: list[float] = field(default_factory=list)
    at_least: float = 0.0

    @property
    def seen(self) -> str:
        """Return the bound of a stiffness and the deflections it was seen at, "" if they are not known."""
        (low, high), unit = self.deflections or (0.0, 0.0), self.unit
        bound = f"at least {self.at_least:.3g} {unit}, " if self.at_least else ""
        seen = f"{bound}seen at deflections of {1e3 * low:.3g} to {1e3 * high:.3g} m{unit.rpartition('/')[2]}"
        return seen if self.deflections else ""


@dataclass(frozen=True, eq=False)
class Fit:
    """Measured and predicted signals of one record by name, `q_l`, `q_m`, `torque` or DEFLECTION, each (k, n).

    DEFLECTION [rad]: of a record that is not simulated, from its filtered motion, less its mean. noise (n,): standard
    deviation of the measurement of each joint; of DEFLECTION the root mean square residual. explained (n,): share of
    the deflection's variance that the model explains, NaN where there is no link measurement.
    """

    record: str
    t: Array
    measured: Mapping[str, Array]
    predicted: Mapping[str, Array]
    noise: Mapping[str, Array]
    explained: Array


@dataclass(frozen=True, eq=False)
class Identification:
    """Estimates of all parameters, and the posterior of those that are not UNKNOWN.

    coordinates: LOG, NONNEGATIVE, LINEAR or SQUARE per entry of the posterior; free: index into `estimates` of each
    entry. mean (p,) and covariance (p, p) are in these coordinates.
    """

    joints: tuple[str, ...]
    estimates: tuple[Estimate, ...]
    free: tuple[int, ...]
    coordinates: tuple[str, ...]
    mean: Array
    covariance: Array
    fits: tuple[Fit, ...] = ()

    def value(self, name: str) -> Array:
        """Return the values of a parameter for all joints that have it, in their order."""
        return np.array([each.value for each in self.estimates if each.name == name])

    def check_joints(self, joints: Sequence[str]) -> None:
        """Raise ParameterError unless the identification is of these joints."""
        if self.joints != tuple(joints):
            raise ParameterError(
                f"the identification is of joints {', '.join(self.joints)}; expected those of the scenario, "
                f"{', '.join(joints)}"
            )

    def draws(self, count: int, seed: int, first: int = 0, widest: float = WHOLE) -> Array:
        """Return the draws (count, len(estimates)) from the number `first` on; UNKNOWN parameters keep their prior.

        widest: standard deviations at which z is truncated; the default leaves the posterior whole.
        """
        normal = draws.standard_normal(draws.uniform(STREAM, seed, first, count, len(self.mean)), widest)
        w, v = np.linalg.eigh(self.covariance)
        z = self.mean + normal @ (v * np.sqrt(np.maximum(w, 0.0))) @ v.T
        drawn = np.tile([each.value for each in self.estimates], (len(normal), 1))
        for k, (index, coordinate) in enumerate(zip(self.free, self.coordinates, strict=True)):
            drawn[:, index] = natural(z[:, k], coordinate)
        return drawn

    @cached_property
    def places(self) -> dict[int, tuple[Deviation, int]]:
        """Return deviation and entry in it of the estimates that can be drawn, by their indices."""
        found = {}
        for index, each in enumerate(self.estimates):
            name, _, axis = each.name.rpartition("_")
            if each.name in NAMES:
                found[index] = NAMES[each.name], self.joints.index(each.joint) if each.joint else 0
            elif name in NAMES and NAMES[name].per == POINT:
                found[index] = NAMES[name], "xyz".index(axis)
        return found

    def values(self, table: Array, one: Deviation, nominal: Array) -> Array:
        """Return the values (k, .) of a deviation from the draws (k, p) of all estimates, nominal ones without any."""
        found = np.tile(nominal, (len(table), 1))
        for index, (of, entry) in self.places.items():
            if of is one:
                found[:, entry] = table[:, index]
        return found

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for identification.json; from_dict makes the same identification, without fits."""
        return {
            "joints": list(self.joints),
            "estimates": [asdict(each) for each in self.estimates],
            "free": list(self.free),
            "coordinates": list(self.coordinates),
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
        }

    @classmethod
    def from_dict(cls, values: Any) -> Identification:
        """Return the identification of `as_dict`; raises ParameterError for other values."""
        try:
            found = cls(
                tuple(values["joints"]),
                tuple(Estimate(**each) for each in values["estimates"]),
                tuple(values["free"]),
                tuple(values["coordinates"]),
                np.array(values["mean"], dtype=float),
                np.array(values["covariance"], dtype=float).reshape(len(values["mean"]), -1),
            )
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise ParameterError(
                f"is no identification ({error!r}); expected the file identification.json of an identified robot"
            ) from None
        p = len(found.free)
        shapes = len(found.coordinates), found.mean.shape, found.covariance.shape
        if shapes != (p, (p,), (p, p)) or not all(0 <= i < len(found.estimates) for i in found.free):
            raise ParameterError(f"has a posterior of sizes {shapes} for {p} parameters; expected equal sizes")
        if not (np.all(np.isfinite(found.mean)) and np.all(np.isfinite(found.covariance))):
            raise ParameterError("has a posterior that is not finite; expected finite means and covariances")
        return found


def read_identification(path: Path) -> Identification:
    """Return the identification in a file, identification.json; raises ParameterError, which names the file."""
    try:
        return Identification.from_dict(json.loads(read_text(path)))
    except OSError as error:
        raise ParameterError(f"cannot read identification {path} ({error.strerror}); expected a text file") from None
    except (ValueError, ParameterError) as error:  # JSONDecodeError and UnicodeDecodeError are ValueErrors
        raise ParameterError(f"{path}: {error}") from None


def drawn_plants(found: Identification, robot: Robot, count: int, seed: int, widened: float = 1.0) -> DrawnPlants:
    """Return `count` plants; what is not identified is as in the robot, which has the joints of the identification.

    widened: factor on the posterior's standard deviations. The delay of a plant is the largest of its joints. Raises
    ParameterError for a robot whose stiffness, motor inertia or damping couples its joints.
    """
    table, columns = replace(found, covariance=widened**2 * found.covariance).draws(count, seed), {}
    for name, matrix in MATRICES.items():
        if not is_diagonal(getattr(robot, matrix)):
            raise ParameterError(f"{matrix} of the robot couples its joints; expected a diagonal matrix, as identified")
        own = np.diag(getattr(robot, matrix))
        least = LEAST * own if matrix in ("K", "M_m") else 0.0
        columns[NAMES[name].name] = np.maximum(found.values(table, NAMES[name], own), least)
    return DrawnPlants(**columns, delay=found.values(table, NAMES[DELAY], np.zeros(robot.n)).max(axis=1))


@dataclass(frozen=True, eq=False)
class PosteriorDraws:
    """Draws of an identification as deviations from a robot with its joints.

    Stiffness, motor inertia and damping are factors on the values of the robot, friction and payload are levels; a
    cubic stiffness is beside the curve of the robot, which its stiffness scales; delay and smoothing are the largest of
    the joints. Raises ParameterError for other joints and for a factor on a value of zero.
    """

    found: Identification
    robot: Robot
    joints: tuple[str, ...]

    def __post_init__(self) -> None:
        self.found.check_joints(self.joints)
        _ = self.columns

    @cached_property
    def columns(self) -> dict[str, list[DrawnColumn]]:
        """Return the drawn numbers by deviation, with their marginals; those that are not identified are not drawn."""
        found: dict[str, list[DrawnColumn]] = {one.name: [] for one in NAMES.values()}
        for k, index in enumerate(self.found.free):
            if index not in self.found.places:
                continue
            each, (one, entry) = self.found.estimates[index], self.found.places[index]
            scale = float(self._nominal(one)[entry]) if one.matrix else 1.0
            if not scale > 0:
                zero = f"{each.name} of {each.joint} is 0 in the scenario"
                raise ParameterError(f"{zero}; expected the identified robot file, whose values the posterior scales")
            mean, deviation = float(self.found.mean[k]), max(float(np.sqrt(self.found.covariance[k, k])), 1e-12)
            if one.name == CUBIC:
                beside = self._values(one, self.found.draws(SAMPLES, 0))[:, entry]
                mean, deviation = float(beside.mean()), max(float(beside.std()), 1e-12)
            marginal = Distribution(NORMAL, (mean / scale, deviation / scale))
            if self.found.coordinates[k] == LOG:
                marginal = Distribution(LOG_NORMAL, (float(np.exp(mean)) / scale, deviation))
            suffix = "" if one.per_run else f".{'xyz'[entry] if one.per == POINT else each.joint}"
            column = DrawnColumn(one.name + suffix, one.name, 0 if one.per_run else entry, marginal)
            columns = [*found[one.name], column]
            found[one.name] = [max(columns, key=lambda each: each.distribution.numbers[0])] if one.per_run else columns
        return {name: columns for name, columns in found.items() if columns}

    @property
    def left_out(self) -> tuple[str, ...]:
        """Return the names of identified parameters that a study does not draw, such as the offset."""
        left = (i for i in self.found.free if i not in self.found.places)
        return tuple(dict.fromkeys(self.found.estimates[i].name for i in left))

    def drawn(self, seed: int, first: int, count: int) -> dict[str, Array]:
        """Return the draws by deviation, (count, n), (count,) or (count, 3), of the runs from `first` on."""
        table, found = self.found.draws(count, seed, first, draws.WIDEST), {}
        for name in self.columns:
            values = self._values(DEVIATIONS[name], table)
            found[name] = np.maximum(values.max(axis=1), 0.0) if DEVIATIONS[name].per_run else values
        return found

    def _values(self, one: Deviation, table: Array) -> Array:
        """Return the values (k, .) of a deviation from the draws (k, p) of all estimates."""
        nominal = self._nominal(one)
        values = self.found.values(table, one, nominal)
        if one.matrix:
            return values / np.where(nominal > 0, nominal, 1.0)
        return values - self._values(DEVIATIONS["stiffness"], table) * nominal if one.name == CUBIC else values

    def range(self, name: str) -> tuple[float, float]:
        """Return the smallest and the largest value of a deviation, by its marginals."""
        ranges = [column.distribution.range for column in self.columns[name]]
        return min(low for low, _ in ranges), max(high for _, high in ranges)

    def _nominal(self, one: Deviation) -> Array:
        """Return the values of the robot, and zeros for those that it has not: levels of joints or of x, y, z."""
        if one.matrix:
            return np.diag(getattr(self.robot, one.matrix))
        if one.name == CUBIC and self.robot.cubic is not None:
            return self.robot.cubic
        return np.zeros(3 if one.per == POINT else len(self.joints))
