# SPDX-License-Identifier: Apache-2.0
"""Boxes by their lower and upper bounds, tubes, and the enclosure of CasADi functions on boxes."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from ...errors import StateError
from ...numerics.checks import Array
from ...verification.interval_function import IntervalFunction
from ...verification.intervals import Interval

WIDER = 1 + 2.0**-48
"""Factor on a radius that covers the rounding of the conversion between bounds and midpoints."""
TINY = 2.0**-1000


class Box(NamedTuple):
    """Lower and upper bounds, arrays of equal shape."""

    lower: Array
    upper: Array

    @classmethod
    def around(cls, middle: Array, radius: Array) -> Box:
        """Return the box middle +- radius, rounded outwards."""
        return cls(np.nextafter(middle - radius, -np.inf), np.nextafter(middle + radius, np.inf))

    @classmethod
    def point(cls, values: Array) -> Box:
        """Return the box that contains these values only."""
        return cls(values, values)

    @property
    def interval(self) -> Interval:
        """The box by midpoint and radius, rounded outwards."""
        middle = (self.lower + self.upper) / 2
        radius = np.maximum(self.upper - middle, middle - self.lower)
        return Interval(middle, WIDER * radius + 2.0**-52 * np.abs(middle) + TINY)

    def distance(self, point: Array) -> Array:
        """Return the largest distances of numbers in the box from a point."""
        return np.asarray(np.nextafter(np.maximum(self.upper - point, point - self.lower), np.inf))


class Tube(NamedTuple):
    """Deviations z (4n,) with |S z| at most `radius` (4n,)."""

    S_inverse: Array
    radius: Array

    def box(self, k: int) -> Box:
        """Return k boxes (4n, k) that contain the tube."""
        radius = np.tile((np.abs(self.S_inverse) @ self.radius)[:, None], k)
        return Box(-radius, radius)

    def corners(self, share: Array) -> Array:
        """Return points (4n, k) of the tube at shares (4n, k) of its width."""
        return np.asarray(self.S_inverse @ ((2 * share - 1) * self.radius[:, None]))


def enclosure(function: ca.Function, *arguments: Box) -> list[Box]:
    """Return boxes (size, k) that contain the outputs of a function on k boxes of its arguments (size, k) each.

    Matrices are in column-major order. Raises ZeroDivisionError if a divisor may vanish.
    """
    points = [np.all(box.lower == box.upper) for box in arguments]
    given = [Interval.exact(box.lower) if exact else box.interval for exact, box in zip(points, arguments, strict=True)]
    return [Box.around(result.mid, result.rad) for result in _evaluator(function)(*given)]


def enclosable(function: ca.Function) -> bool:
    """Return whether all operations of a function can be evaluated on intervals."""
    try:
        _evaluator(function)
    except StateError:
        return False
    return True


_evaluator = lru_cache(maxsize=8)(IntervalFunction)
