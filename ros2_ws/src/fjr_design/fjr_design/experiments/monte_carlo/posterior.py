# SPDX-License-Identifier: Apache-2.0
"""Draw the plants of a study from the posterior of an identification: correlated, each by the number of its run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fjr_core.errors import ParameterError
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.simulation.batch import counter_rng

from ...posterior.drawn_plants import MATRICES, check_joints, drawn_values
from ...posterior.result import LOG, Estimate, Identification
from . import distributions
from .distributions import LOG_NORMAL, NORMAL, Distribution

FACTORS = {
    "joint_stiffness": "stiffness",
    **{name: name for name in ("motor_inertia", "link_damping", "motor_damping")},
}
LEVELS = {"link_coulomb_friction": "coulomb_l", "motor_coulomb_friction": "coulomb_m"}
DELAY, MASS = "effort_delay", "payload_mass"
POSITION = ("payload_position_x", "payload_position_y", "payload_position_z")
STREAM = "posterior"


class Column(NamedTuple):
    """A drawn number: label after the name of its parameter, "" for none; its entry; marginal distribution."""

    label: str
    entry: int
    marginal: Distribution


@dataclass(frozen=True, eq=False)
class PosteriorDraws:
    """Draws of an identification as deviations from a robot with its joints.

    Stiffness, motor inertia and damping are factors on the values of the robot, friction and payload are levels; the
    delay is the largest of the joints. Raises ParameterError for other joints and for a factor on a value of zero.
    """

    found: Identification
    robot: Robot
    joints: tuple[str, ...]

    def __post_init__(self) -> None:
        check_joints(self.found, self.joints)
        for name in FACTORS:
            for column in self._columns(name):
                if not self._own(name)[column.entry] > 0:
                    raise ParameterError(
                        f"{name} of {column.label} is 0 in the scenario; expected the identified robot file, "
                        "whose values the posterior scales"
                    )

    @cached_property
    def columns(self) -> dict[str, tuple[Column, ...]]:
        """Return the drawn numbers by field of Draws; those that are not identified are not drawn."""
        found = {level: self._columns(name) for name, level in (FACTORS | LEVELS).items()}
        delays = self._columns(DELAY)
        latest = max(delays, key=lambda column: column.marginal.numbers[0], default=None)
        found["delay"] = (Column("", 0, latest.marginal),) if latest else ()
        found["payload_mass"] = self._columns(MASS)
        axes = [(axis[-1], i, self._columns(axis)) for i, axis in enumerate(POSITION)]
        found["payload_position"] = tuple(Column(label, i, own[0].marginal) for label, i, own in axes if own)
        return {level: columns for level, columns in found.items() if columns}

    @property
    def left_out(self) -> tuple[str, ...]:
        """Return the names of identified parameters that a study does not draw, such as the offset."""
        used = {*FACTORS, *LEVELS, DELAY, MASS, *POSITION}
        return tuple(
            dict.fromkeys(self._estimate(k).name for k in self.found.free if self._estimate(k).name not in used)
        )

    def drawn(self, seed: int, first: int, count: int) -> dict[str, Array]:
        """Return the draws by field of Draws, (count, n), (count,) or (count, 3), of the runs from `first` on."""
        words = counter_rng.rows((seed, distributions.stream(STREAM)), first, count, len(self.found.mean))
        table = self.found.at(distributions.standard_normal(counter_rng.unit(words)))
        values: dict[str, Array] = {}
        for name, level in (FACTORS | LEVELS).items():
            if level in self.columns:
                own = self._own(name) if name in FACTORS else np.ones(len(self.joints))
                values[level] = self._by_joint(table, name, own) / np.where(own > 0, own, 1.0)
        if "delay" in self.columns:
            values["delay"] = np.maximum(self._by_joint(table, DELAY, np.zeros(len(self.joints))).max(axis=1), 0.0)
        if "payload_mass" in self.columns:
            values["payload_mass"] = drawn_values(self.found, table, MASS)[""]
        if "payload_position" in self.columns:
            values["payload_position"] = np.stack([drawn_values(self.found, table, axis)[""] for axis in POSITION], 1)
        return values

    def range(self, level: str) -> tuple[float, float]:
        """Return the smallest and the largest value of a field of Draws, by its marginals."""
        ranges = [column.marginal.range for column in self.columns[level]]
        return min(low for low, _ in ranges), max(high for _, high in ranges)

    def _by_joint(self, table: Array, name: str, own: Array) -> Array:
        """Return the draws (k, n) of a parameter of the joints; own (n,): of joints that have none."""
        values = drawn_values(self.found, table, name)
        return np.stack([values.get(joint, np.full(len(table), own[j])) for j, joint in enumerate(self.joints)], axis=1)

    def _columns(self, name: str) -> tuple[Column, ...]:
        """Return the drawn numbers of an estimated parameter, one per joint that has it, or one of the arm."""
        columns = []
        for k, index in enumerate(self.found.free):
            each = self._estimate(index)
            if each.name == name:
                j = self.joints.index(each.joint) if each.joint else 0
                scale = self._own(name)[j] if name in FACTORS else 1.0
                columns.append(Column(each.joint, j, self._marginal(k, scale if scale > 0 else 1.0)))
        return tuple(columns)

    def _marginal(self, k: int, scale: float) -> Distribution:
        mean, deviation = float(self.found.mean[k]), float(np.sqrt(self.found.covariance[k, k]))
        deviation = max(deviation, 1e-12)
        if self.found.coordinates[k] == LOG:
            return Distribution(LOG_NORMAL, (float(np.exp(mean)) / scale, deviation))
        return Distribution(NORMAL, (mean / scale, deviation / scale))

    def _own(self, name: str) -> Array:
        return np.diag(getattr(self.robot, MATRICES[name]))

    def _estimate(self, index: int) -> Estimate:
        return self.found.estimates[index]


def column_names(columns: Sequence[Column], level: str) -> list[str]:
    """Return the names of the columns of a field of Draws in the table of a study."""
    return [f"{level}.{column.label}" if column.label else level for column in columns]
