# SPDX-License-Identifier: Apache-2.0
"""Motion limits, and checks of references and points against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import TrajectoryError
from ..model.joints import REVOLUTE, JointLimits, Units
from ..numerics.checks import Array, freeze, instance, limits
from ..numerics.one_line import one_line
from .piecewise_polynomial import PolynomialReference
from .reference import Reference, check_reference
from .spline import Spline

ROUNDING, LEAST = 1e-9, 1e-3  # relative tolerance of a limit, and the limit below which it is constant
_NUMBERS = ("lower", "upper", "velocity", "acceleration")


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of n joints: positions lower, upper [rad], |velocity| [rad/s] and |acceleration| [rad/s^2], each (n,).

    Scalars apply to every joint; infinite means no limit. units: units of each joint, revolute by default.
    Raises TrajectoryError for a wrong length, nan, a negative velocity or acceleration, or lower > upper.
    """

    lower: ArrayLike
    upper: ArrayLike
    velocity: ArrayLike = np.inf
    acceleration: ArrayLike = np.inf
    units: tuple[Units, ...] = ()

    __repr__ = one_line

    def __post_init__(self) -> None:
        n = max(int(np.size(getattr(self, name))) for name in _NUMBERS)
        for name in _NUMBERS:
            freeze(self, name, limits(f"{name} limit", getattr(self, name), n, TrajectoryError))
        object.__setattr__(self, "units", self.units or (REVOLUTE,) * n)
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        if not np.all(lower <= upper):
            raise TrajectoryError(f"lower limit is {lower.tolist()}, upper {upper.tolist()}; expected lower <= upper")
        for name in ("velocity", "acceleration"):
            limit = np.asarray(getattr(self, name))
            if np.any(limit < 0):
                raise TrajectoryError(f"{name} limit is {limit.tolist()}; expected no negative number")

    @staticmethod
    def of(
        limits: JointLimits | None, n: int, acceleration: ArrayLike = np.inf, units: tuple[Units, ...] = ()
    ) -> MotionLimits:
        """Return robot.limits (None: n joints without limits) with acceleration limits, and robot.units."""
        if limits is None:
            return MotionLimits(np.full(n, -np.inf), np.full(n, np.inf), np.inf, acceleration, units)
        return MotionLimits(limits.lower, limits.upper, limits.velocity, acceleration, units)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(np.size(self.lower))

    @property
    def minimum(self) -> Array:
        """Lower limits (3, n) of position, velocity and acceleration."""
        return np.array([self.lower, -np.asarray(self.velocity), -np.asarray(self.acceleration)])

    @property
    def maximum(self) -> Array:
        """Upper limits (3, n) of position, velocity and acceleration."""
        return np.array([self.upper, self.velocity, self.acceleration])


def check_motion(
    reference: Reference, limits: MotionLimits, t0: float = 0.0, t1: float = np.inf, joints: Sequence[str] = ()
) -> None:
    """Raise TrajectoryError if the reference exceeds the limits between t0 and t1 [s] (may be infinite).

    The message names the joint (by `joints`, else by its index), the point of a Spline or the time, the value and the
    limit. The given points are checked first, then the bounds of the motion. Polynomials whose convex hull is within
    the limits need no further check.
    """
    check_reference(reference, "motion_bounds")
    instance("limits", limits, MotionLimits, TrajectoryError, "a fjr.MotionLimits, e.g. of(robot.limits, robot.n)")
    if limits.n != reference.n:
        raise TrajectoryError(f"limits are of {limits.n} joints; expected those of the reference, {reference.n}")
    if isinstance(reference, Spline):
        _check_points(reference, limits, t0, joints)
    if isinstance(reference, PolynomialReference) and not any(beyond(e, limits).any() for e in reference.hull(t0, t1)):
        return
    e = reference.motion_bounds(t0, t1)
    for values, at in ((e.lower, e.lower_at), (e.upper, e.upper_at)):
        wrong = np.argwhere(beyond(values, limits))
        if len(wrong):
            row, joint = wrong[0]
            when = "" if np.isnan(at[row, joint]) else f" at {at[row, joint]:.4g} s"
            subject = f"joint {_name(joints, joint)} would reach"
            raise TrajectoryError(f"{subject} {_message(values[:, joint], limits, row, joint, when)}")


def _check_points(spline: Spline, limits: MotionLimits, t0: float, joints: Sequence[str]) -> None:
    """Raise TrajectoryError if a given point of the spline from t0 [s] on exceeds the limits."""
    given = (spline.positions, spline.velocities, spline.accelerations)
    points = np.stack([np.zeros(np.shape(spline.positions)) if row is None else row for row in given], axis=1)
    wrong = np.argwhere(beyond(points, limits) & (np.asarray(spline.times) >= t0)[:, None, None])
    if len(wrong):
        point, row, joint = wrong[0]
        subject = f"point {point} of joint {_name(joints, joint)} asks for"
        raise TrajectoryError(f"{subject} {_message(points[point, :, joint], limits, row, joint)}")


def beyond(values: Array, limits: MotionLimits) -> NDArray[np.bool_]:
    """Return which of the values (.., 3, n) exceed their limits by more than rounding."""
    minimum, maximum = limits.minimum, limits.maximum
    below, above = (ROUNDING * np.maximum(np.abs(each), LEAST) for each in (minimum, maximum))
    return np.asarray((values < minimum - below) | (values > maximum + above))


def _message(values: Array, limits: MotionLimits, row: int, joint: int, when: str = "") -> str:
    """Format the value (3,)[row] with its time and the limit it exceeds."""
    value, unit = values[row], limits.units[joint][row]
    limit = limits.maximum[row, joint] if value > limits.maximum[row, joint] else limits.minimum[row, joint]
    if row:
        value, limit = abs(value), abs(limit)
    digits = 12 if f"{value:.6g}" == f"{limit:.6g}" else 6  # enough to distinguish the value from the limit
    return f"{value:.{digits}g} {unit}{when}; its limit is {limit:.6g} {unit}"


def _name(joints: Sequence[str], joint: int) -> str:
    return f"'{joints[joint]}'" if len(joints) else str(joint)
