# SPDX-License-Identifier: Apache-2.0
"""A domain of joint positions: a box, or the tube around a reference; and how far a proof on it is to go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..model.configuration_sampling import bounds_of
from ..model.robot import Robot
from ..numerics import checks
from ..numerics.checks import Array
from .reference import Reference
from .sine import Sines

GOAL = 0.998
"""Proven number relative to the one that is attained, at which the search of a proof ends."""
MOST_BOXES = 4000
"""Boxes after which the search of a proof ends."""
PARTS = 32  # intervals of time of a motion, each with a box
ROUNDING = 1e-9
"""Length [rad, m] by which boxes are larger, as bounds of the motion are exact up to rounding."""


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


def tube(reference: Reference, radius: ArrayLike) -> Domain:
    """Return the positions with |q_l - q_ld(t)| <= radius (n,) [rad, m] in each joint at some time t >= 0.

    A reference that ends, or sines with a common period, have a box for each of PARTS intervals of time. Others have
    one box. Raises TrajectoryError for a radius that is not finite and positive.
    """
    reach = checks.positive_vector("radius", radius, reference.n, TrajectoryError) + ROUNDING
    whole = reference.motion_bounds(0.0, np.inf)
    lower, upper = whole.lower[0] - reach, whole.upper[0] + reach
    horizon = _horizon(reference)
    if horizon is None:
        return Domain(lower, upper)
    ends = np.linspace(0.0, horizon, PARTS + 1)
    intervals = [*zip(ends[:-1], ends[1:], strict=True)]
    if np.isfinite(reference.end):
        intervals.append((horizon, np.inf))
    bounds = [reference.motion_bounds(float(t0), float(t1)) for t0, t1 in intervals]
    near = np.array([[each.lower[0] - reach, each.upper[0] + reach] for each in bounds])
    return Domain(np.minimum(lower, near[:, 0].min(axis=0)), np.maximum(upper, near[:, 1].max(axis=0)), near)


def _horizon(reference: Reference) -> float | None:
    """Return the time [s] after which a reference is constant or repeats itself; None if there is no such time."""
    if np.isfinite(reference.end):
        return float(reference.end) if reference.end > 0 else None
    if not isinstance(reference, Sines):
        return None
    moving = np.unique(np.abs(reference.rows[1][reference.rows[1] != 0]))
    if not len(moving) or np.any(moving % moving[0] != 0):
        return None
    return float(2 * np.pi / moving[0] * (1 + ROUNDING))
