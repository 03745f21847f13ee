# SPDX-License-Identifier: Apache-2.0
"""Estimate the input delay by regressing the effort that the motor equation requires on time-shifted commands."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..numerics.checks import Array
from ..robot.robot import Robot
from . import thresholds
from .innovations import Innovations, needed


@dataclass(frozen=True)
class EffortDelay:
    """Input delay: `whole` samples plus a `fraction` of the interval, during which the previous effort acts.

    measured: estimated from the measured torque; `whole` is then 0.
    """

    whole: int = 0
    fraction: float = 0.0
    measured: bool = False

    @property
    def late(self) -> bool:
        """Return whether the delay is not zero."""
        return self.whole > 0 or self.fraction > 0


@dataclass(frozen=True)
class Acting:
    """Deviation (k, n) [N m] of the acting effort from the sent one in each interval, by its reason."""

    cut: Array
    late: Array
    lost: Array
    age: float  # samples, median delay

    def last(self, count: int) -> Acting:
        """Return the deviations of the last `count` intervals."""
        return Acting(self.cut[-count:], self.late[-count:], self.lost[-count:], self.age)


def effort_delay(found: Innovations, robot: Robot) -> EffortDelay:
    """Estimate the input delay that best explains the effort that the motor equation requires.

    Only changes from interval to interval are compared, which removes slow disturbances. A delay is accepted if it
    explains more than a factor on each effort, which a wrong motor inertia would make.
    """
    required, regular = needed(found, robot), _regular(found)
    undelayed = _squares(required - found.sent, regular)
    delayed = [_delayed(found.sent, d) for d in range(thresholds.OLDEST + 1)]
    fits = [_fit(required, newer, older, regular) for newer, older in pairwise(delayed)]
    whole = min(range(thresholds.OLDEST), key=lambda d: fits[d][1])
    fraction, left = fits[whole]
    accepted = left < min((1 - thresholds.EXPLAINED) * undelayed, _scaled(required, found.sent, regular))
    if np.isfinite(found.after).all() and np.isfinite(found.before).all():
        measured, residual = _fit(required, found.after, found.before, regular)
        if residual <= max(thresholds.NO_WORSE * left, thresholds.EXACT * undelayed) or not accepted:
            unmixed = _squares(required - found.after, regular)
            mixed = residual < (1 - thresholds.HALF_WAY) * unmixed and unmixed > thresholds.NEGLIGIBLE * _squares(
                found.sent, regular
            )
            return EffortDelay(0, measured if mixed else 0.0, True)
    if not accepted:
        return EffortDelay()
    return EffortDelay(whole + 1) if fraction > 1 - thresholds.EXACT else EffortDelay(whole, fraction)


def acting(found: Innovations, age: EffortDelay, required: Array) -> Acting:
    """Classify the deviations of the acting effort: saturated by the motor, delayed, or held because one was lost.

    required (k, n) [N m]: effort that the motor equation requires; used if the torque was not measured.
    """
    if age.measured:
        samples, newer, older = _samples(found.sent, found.after), found.after, found.before
        cut = _clipped(found.sent, found.after)
    else:
        samples, cut = age.whole + _samples(found.sent, required, age.whole), np.zeros_like(found.sent, dtype=bool)
        newer, older = (_delayed(found.sent, samples + more) for more in (0, 1))
    regular = _regular(found)
    whole = _squares(required - newer, regular) <= thresholds.MIXED * _squares(
        newer - older, regular
    )  # no change in an interval
    if not (whole or age.measured or age.late):  # an older effort is nearest by chance
        samples, newer = np.zeros_like(samples), found.sent
    usual = float(np.median(samples)) if len(samples) else 0.0
    total = usual + age.fraction
    difference = (1 - age.fraction) * newer + age.fraction * older - found.sent
    limit = np.inf if not whole else 0.5 if total < thresholds.LATE else usual + 1.5
    lost = (samples > limit)[:, None] & ~cut
    zero = np.zeros_like(difference)
    return Acting(
        cut=np.where(cut, difference, zero),
        late=np.where(cut | lost, zero, difference),
        lost=np.where(lost, difference, zero),
        age=total,
    )


def _regular(found: Innovations) -> NDArray[np.bool_]:
    """Return which changes (k - 1,) are between intervals of usual length; all of them unless latencies are known."""
    if not found.latency.any():
        return np.ones(max(0, len(found) - 1), dtype=bool)
    usual = np.median(found.dt)
    good = (np.abs(found.dt - usual) <= thresholds.REGULAR * usual) & (found.latency < 1.0)
    return np.asarray(good[1:] & good[:-1])


def _fit(required: Array, newer: Array, older: Array, regular: NDArray[np.bool_]) -> tuple[float, float]:
    """Fit the fraction of `older`, 0 to 1, in the required effort; return it and the residual sum of squares."""
    y, b = _changes(required - newer, regular), _changes(older - newer, regular)
    power = float((b * b).sum())
    fraction = float(np.clip((b * y).sum() / power, 0.0, 1.0)) if power > 0 else 0.0
    return fraction, float(((y - fraction * b) ** 2).sum())


def _scaled(required: Array, sent: Array, regular: NDArray[np.bool_]) -> float:
    """Return the residual sum of squares of the best fit by a constant factor on each effort."""
    y, b = _changes(required, regular), _changes(sent, regular)
    power = (b * b).sum(axis=0)
    factors = np.divide((b * y).sum(axis=0), power, out=np.ones_like(power), where=power > 0)
    return float(((y - factors * b) ** 2).sum())


def _squares(residual: Array, regular: NDArray[np.bool_]) -> float:
    """Return the sum of squares of the changes of a residual (k, n)."""
    return float((_changes(residual, regular) ** 2).sum())


def _changes(values: Array, regular: NDArray[np.bool_]) -> Array:
    """Return the regular changes from interval to interval, without the first OLDEST, whose efforts are unknown."""
    return np.asarray(np.diff(values, axis=0)[thresholds.OLDEST :][regular[thresholds.OLDEST :]])


def _delayed(u: Array, samples: int | NDArray[np.intp]) -> Array:
    """Return efforts (k, n) delayed by `samples`, a number or (k,); the first effort before the start."""
    return u[np.maximum(np.arange(len(u)) - samples, 0)]


def _samples(sent: Array, acting: Array, whole: int = 0) -> NDArray[np.intp]:
    """Return the delay (k,) in samples, beyond `whole`, of the sent effort that equals the acting one; 0: none does."""
    distances = np.array([np.abs(acting - _delayed(sent, whole + j)).max(axis=1) for j in range(thresholds.OLDEST + 1)])
    nearest = np.argmin(distances, axis=0)
    return np.where(distances.min(axis=0) <= thresholds.SAME_OLDER * distances[0], nearest, 0)


def _clipped(sent: Array, acting: Array) -> NDArray[np.bool_]:
    """Return where (k, n) the motor is saturated: at its largest torque for CLIPPED_FOR intervals, commanded more."""
    size = np.abs(acting)
    at_most = size >= (1 - thresholds.CLIPPED_LEVEL) * size.max(axis=0, initial=0.0)
    more = (np.abs(sent) > (1 + thresholds.CLIPPED_BY) * size) & (sent * acting > 0)
    return _runs(at_most & more, thresholds.CLIPPED_FOR)


def _runs(flags: NDArray[np.bool_], length: int) -> NDArray[np.bool_]:
    """Return the flags (k, n) that belong to runs of at least `length` along the first axis."""
    kept = np.zeros_like(flags)
    for j, column in enumerate(flags.T):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], column.astype(int), [0]])))
        for start, end in edges.reshape(-1, 2):
            kept[start:end, j] = end - start >= length
    return kept
