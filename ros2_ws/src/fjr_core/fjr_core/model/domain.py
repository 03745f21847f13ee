# SPDX-License-Identifier: Apache-2.0
"""A domain of joint positions: a box, or the positions near a motion; and how far a proof on it is to go."""

from __future__ import annotations

from dataclasses import dataclass

from ..numerics.checks import Array
from .configuration_sampling import bounds_of
from .robot import Robot

GOAL = 0.998
"""Proven number relative to the one that is attained, at which the search of a proof ends."""
MOST_BOXES = 4000
"""Boxes after which the search of a proof ends."""


@dataclass(frozen=True, eq=False)
class Domain:
    """Joint positions in a box lower, upper (n,) [rad, m], or only those near a motion.

    near (k, 2, n): lower and upper ends of boxes; if given, the domain is their union, within the large box.
    """

    lower: Array
    upper: Array
    near: Array | None = None


def joint_range(robot: Robot) -> Domain:
    """Return the box of the joint limits; joints without limits have +-pi."""
    return Domain(*bounds_of(robot))
