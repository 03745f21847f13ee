# SPDX-License-Identifier: Apache-2.0
"""Limits and measured states of the joints of a robot, and the units of revolute and prismatic joints."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np

from ..errors import RobotError
from ..numerics.checks import Array, freeze, limits
from ..numerics.one_line import one_line


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of n joints, each (n,): positions lower, upper [rad], velocity [rad/s] and effort [N m], both > 0.

    Prismatic joints use m and N. An infinite value means no limit. Raises RobotError.
    """

    lower: Array
    upper: Array
    velocity: Array
    effort: Array

    __repr__ = one_line

    def __post_init__(self) -> None:
        n = int(np.size(self.lower))
        for name in ("lower", "upper", "velocity", "effort"):
            freeze(self, name, limits(f"{name} limit", getattr(self, name), n, RobotError))
        if not np.all(self.lower <= self.upper):
            raise RobotError(f"lower is {self.lower.tolist()}, upper {self.upper.tolist()}; expected lower <= upper")
        for name in ("velocity", "effort"):
            if not np.all(getattr(self, name) > 0):
                raise RobotError(f"{name} limit is {getattr(self, name).tolist()}; expected positive numbers")

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.lower)


class Units(NamedTuple):
    """Units of the quantities of one joint."""

    position: str
    velocity: str
    acceleration: str
    effort: str

    def of(self, text: str) -> str:
        """Return a text, which has the units of a revolute joint such as N m s/rad, in those of this joint."""
        pairs = () if self == REVOLUTE else ((r"\bN m\b", "N"), (r"\b(m?)rad\b", r"\1m"), (r"\bkg m\^2", "kg"))
        return reduce(lambda said, pair: re.sub(pair[0], pair[1], said), pairs, text)


REVOLUTE = Units("rad", "rad/s", "rad/s^2", "N m")
PRISMATIC = Units("m", "m/s", "m/s^2", "N")


def in_units(text: str, joints: Iterable[Units]) -> str:
    """Return a text, which has the units of a revolute joint, with the distinct units of several joints."""
    kinds = tuple(joints)
    return re.sub(r"\bm?rad\b|\bN m\b", lambda unit: joined(each.of(unit[0]) for each in kinds), text)


def joined(units: Iterable[str]) -> str:
    """Return the distinct units of several joints, separated by commas, as in "rad, m"."""
    return ", ".join(dict.fromkeys(units))


class JointSample(NamedTuple):
    """A measured state: stamp [ns], positions [rad] and velocities [rad/s] of links and motors, each (n,).

    q_m, dq_m: as in the message, before the gear; q_m is the joint torque [N m] where that is measured instead.
    Velocities are None if an observer estimates them.
    """

    stamp: int
    q_l: Array
    q_m: Array
    dq_l: Array | None = None
    dq_m: Array | None = None
