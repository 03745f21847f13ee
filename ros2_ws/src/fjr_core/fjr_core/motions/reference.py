# SPDX-License-Identifier: Apache-2.0
"""Reference trajectories of class C^4: value and four exact derivatives at every time, and bounds of the motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING
from functools import partial
from math import inf
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import TrajectoryError
from ..numerics.checks import Array, kind_of
from ..numerics.parameter_field import VECTOR, parameter_field

Indices = NDArray[np.intp]

ROWS = 3  # position, velocity, acceleration
_REFINEMENTS, _NEWTON_STEPS = 2, 8
REFERENCE_DERIVATIVES = 4  # q_ld .. d4q_ld: the law has relative degree four
JETS = REFERENCE_DERIVATIVES + 1

motion_field = partial(parameter_field, dynamic=True)
"""A field of a reference that is also its parameter reference.*."""


def offset_field(default: Any = MISSING) -> Any:
    """Return the field of the position about which a reference moves; references share its parameter."""
    description = "Offset of the sines, centre of the circle, position of hold"
    return motion_field(default, description, "rad", name="offset", shape=VECTOR)


class Reference(Protocol):
    """A reference trajectory q_ld(t) of class C^4 in n joints."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def end(self) -> float:
        """Time [s] after which the reference is constant; infinite by default."""
        return inf

    def jets(self, t: ArrayLike) -> Array:
        """Return q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""

    def configurations(self, k: int) -> Array:
        """Return k configurations (k, n) [rad], distributed evenly over the reference."""

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return bounds of position, velocity and acceleration from t0 to t1 [s]; t1 may be infinite."""


def check_reference(reference: object, *others: str) -> None:
    """Raise TrajectoryError unless `reference` is an object with the members n, jets and `others` of a Reference."""
    lacks = [name for name in ("n", "jets", *others) if isinstance(reference, type) or not hasattr(reference, name)]
    if lacks:
        raise TrajectoryError(
            f"reference is {kind_of(reference)} without {lacks[0]}; expected a reference, e.g. fjr.Sine(1.0, 1.0) or "
            "fjr.Spline(times, positions): the law needs four exact derivatives"
        )


class MotionBounds(NamedTuple):
    """Bounds lower, upper (3, n) of q_ld [rad], dq_ld [rad/s] and ddq_ld [rad/s^2] over a time interval.

    lower_at, upper_at (3, n) [s]: times of the extrema; nan if the bound is conservative.
    """

    lower: Array
    upper: Array
    lower_at: Array
    upper_at: Array

    def union(self, other: MotionBounds) -> MotionBounds:
        """Return the bounds of both motions together."""
        less, more = other.lower < self.lower, other.upper > self.upper
        return MotionBounds(*map(np.where, (less, more, less, more), other, self))

    def delayed(self, t0: float) -> MotionBounds:
        """Return the bounds with all times shifted by t0 [s]."""
        return MotionBounds(self.lower, self.upper, self.lower_at + t0, self.upper_at + t0)


def motion_bounds_on(jets: Callable[[Array], Array], grid: Array) -> MotionBounds:
    """Return the bounds of jets(t) on an increasing grid (k,) [s] and at the zeros of derivatives between its points.

    The grid is refined at the zeros of higher derivatives, so that double zeros between grid points are found. An
    interval is searched if its value may exceed the extrema at the grid points, with a slope of at most that at its
    ends.
    """
    for _ in range(_REFINEMENTS):
        rows = jets(grid)[:, 2:]
        interval, row, joint = np.nonzero(_changes_sign(rows))
        zeros = _secant(grid, interval, rows[interval, row, joint], rows[interval + 1, row, joint])
        grid = np.union1d(grid, zeros)
    samples = jets(grid)
    value, slope = samples[:, :ROWS], samples[:, 1 : ROWS + 1]
    reach = np.maximum(np.abs(slope[:-1]), np.abs(slope[1:])) * np.diff(grid)[:, None, None]
    high, low = np.maximum(value[:-1], value[1:]) + reach, np.minimum(value[:-1], value[1:]) - reach
    may_exceed = (high > value.max(axis=0)) | (low < value.min(axis=0))
    interval, row, joint = np.nonzero(_changes_sign(slope) & may_exceed)
    roots = _roots(jets, grid, slope, interval, row, joint)
    t, values = np.tile(grid[:, None, None], (2, *value.shape[1:])), np.concatenate([value, value])
    t[interval, row, joint] = roots
    values[interval, row, joint] = jets(roots)[np.arange(len(roots)), row, joint]
    lowest, highest = values.argmin(axis=0)[None], values.argmax(axis=0)[None]
    chosen = ((values, lowest), (values, highest), (t, lowest), (t, highest))
    return MotionBounds(*(np.take_along_axis(array, at, axis=0)[0] for array, at in chosen))


def _changes_sign(rows: Array) -> NDArray[np.bool_]:
    """Return where numbers (k, ..) change their sign from one row to the next (k - 1, ..); products may overflow."""
    return np.sign(rows[:-1]) * np.sign(rows[1:]) < 0


def _secant(grid: Array, interval: Indices, first: Array, last: Array) -> Array:
    """Return the zeros of straight lines from first to last (opposite signs) in the intervals of the grid."""
    left, right = grid[interval], grid[interval + 1]
    return left + (right - left) * (first / (first - last))


def _roots(
    jets: Callable[[Array], Array], grid: Array, slope: Array, interval: Indices, row: Indices, joint: Indices
) -> Array:
    """Return the zeros of row + 1 in the intervals by Newton's method, safeguarded by bisection."""
    left, right, each = grid[interval], grid[interval + 1], np.arange(len(interval))
    first = slope[interval, row, joint]
    t = _secant(grid, interval, first, slope[interval + 1, row, joint])
    for _ in range(_NEWTON_STEPS):
        found = jets(t)
        f, df = found[each, row + 1, joint], found[each, row + 2, joint]
        before = np.sign(f) == np.sign(first)
        left, right = np.where(before, t, left), np.where(before, right, t)
        t = t - np.divide(f, df, out=np.full_like(f, np.inf), where=df != 0)
        t = np.where((left <= t) & (t <= right), t, (left + right) / 2)
    return t
