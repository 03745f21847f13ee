# SPDX-License-Identifier: Apache-2.0
"""Grade a violation by the tracking error due to its causes, and format that error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_core.monitoring.thresholds import RELATIVE, Axes
from fjr_core.numerics.checks import Array

from .cause_errors import CauseErrors
from .storage_budget import CAUSES

Flags = NDArray[np.bool_]


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
