# SPDX-License-Identifier: Apache-2.0
"""Grade a violation by the tracking error due to its causes, and format that error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..control.vdpbc.law import TrackingLaw
from ..errors import StateError
from ..numerics.checks import Array, vector
from .cause_errors import CauseErrors
from .storage_budget import CAUSES
from .thresholds import RELATIVE, TOLERANCE

Flags = NDArray[np.bool_]

LARGE = 0.1  # rad, m; smaller errors are written in thousandths


@dataclass(frozen=True)
class Axes:
    """Names, units and tolerances of the joints in a diagnosis.

    names, units: of n joints; a unit is "rad" or "m". tolerance (n,) [rad, m]: tracking error up to which a violation
    of the decay of V is a degradation. Raises StateError for numbers that do not fit.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    tolerance: Array

    def __post_init__(self) -> None:
        tolerance = vector("tolerance", self.tolerance, len(self.names), StateError)
        if not (tolerance > 0).all():
            raise StateError(f"tolerance is {tolerance.tolist()}; expected positive numbers")
        if len(self.units) != len(self.names):
            raise StateError(f"units are {self.units}; expected one for each of {len(self.names)} joints")
        object.__setattr__(self, "tolerance", tolerance)

    @classmethod
    def plain(cls, n: int) -> Axes:
        """Return n revolute joints called joint1 .. jointn with the default tolerance."""
        return cls(tuple(f"joint{j + 1}" for j in range(n)), ("rad",) * n, np.full(n, TOLERANCE))

    def storage(self, law: TrackingLaw) -> float:
        """Return V = e' Pi_l e / 2 [J] of links at rest whose error e is the tolerance, at least TOLERANCE."""
        e = np.maximum(self.tolerance, TOLERANCE)
        return float(e @ law.gains.Pi_l @ e) / 2

    def largest(self, errors: Array) -> str:
        """Format the largest of errors (n,) relative to its tolerance: "0.14 mrad at joint2"."""
        j = int(np.argmax(errors / self.tolerance))
        size = f"{errors[j]:.2g} " if errors[j] >= LARGE else f"{1e3 * errors[j]:.2g} m"
        return f"{size}{self.units[j]} at {self.names[j]}"


@dataclass(frozen=True)
class Grade:
    """Largest tracking error (n,) [rad, m] by cause; within: true if all are within the tolerance."""

    errors: dict[str, Array]
    within: bool


class Grading:
    """Largest error (n,) due to each cause in the judged blocks outside a transient, for blocks that come in parts.

    The loop's own error is bounded by an envelope that decays from block to block with the square root of the
    guaranteed factor of V. A block belongs to a transient if that envelope exceeds both the tolerance (n,) and the
    errors due to the causes; if all judged blocks do, all count. Within the tolerance: the errors due to the causes are
    at most the tolerance plus RELATIVE times the envelope.
    """

    def __init__(self, decay: float, tolerance: Array) -> None:
        """decay: guaranteed factor of V in a block."""
        self._decay, self._tolerance = np.sqrt(decay), tolerance
        self._envelope = np.zeros(len(tolerance))
        self._all, self._settled = (Grade({}, True) for _ in range(2))

    def add(self, made: CauseErrors, judged: Flags) -> None:
        """Add blocks; judged (b,): those that count."""
        total, own = made.peaks.sum(axis=1), self._bounded(made.own)
        settled = judged & ~((own > self._tolerance) & (own > total)).any(axis=1)
        within = (total <= self._tolerance + RELATIVE * own).all(axis=1)
        self._all, self._settled = (
            _larger(grade, made.peaks[rows], bool(within[rows].all()))
            for grade, rows in ((self._all, judged), (self._settled, settled))
        )

    def grade(self) -> Grade:
        """Return the grade of the blocks so far."""
        return self._settled if self._settled.errors else self._all

    def _bounded(self, own: Array) -> Array:
        """Return the running maximum of values (b, n), multiplied by the decay from block to block."""
        values = own.copy()
        for value in values:
            np.maximum(value, self._decay * self._envelope, out=value)
            self._envelope = value
        return values


def _larger(grade: Grade, peaks: Array, within: bool) -> Grade:
    """Return the grade with more blocks (b, 4, n); unchanged without any."""
    if not len(peaks):
        return grade
    errors = dict(zip(CAUSES, peaks.max(axis=0), strict=True))
    larger = {cause: np.maximum(error, grade.errors.get(cause, error)) for cause, error in errors.items()}
    return Grade(larger, grade.within and within)


def detail(causes: Sequence[str], errors: dict[str, Array], axes: Axes) -> str:
    """Format causes with the error due to each: "delay makes 0.14 mrad at joint2, sampling"."""
    return ", ".join(f"{cause} makes {axes.largest(errors[cause])}" if cause in errors else cause for cause in causes)
