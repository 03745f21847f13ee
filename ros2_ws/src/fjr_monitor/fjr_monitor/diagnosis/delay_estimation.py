# SPDX-License-Identifier: Apache-2.0
"""Estimate the input delay by regressing the effort that the motor equation requires on time-shifted commands.

All estimates follow from sums over the intervals, so that a record may come in parts of any length.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Innovations, Table

from . import thresholds

BEFORE = 2 * thresholds.OLDEST + 2
"""Intervals before a part of which the sent efforts, or their changes, may still act in it."""
AFTER = thresholds.CLIPPED_FOR - 1
"""Intervals after a part that decide whether a motor was saturated in it."""
_COLUMNS = thresholds.OLDEST + 4


class EffortDelay(NamedTuple):
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
class Acting(Table):
    """Deviation (k, n) [N m] of the acting effort from the sent one in each interval, by its reason."""

    SHARED: ClassVar[tuple[str, ...]] = ("age",)

    cut: Array
    late: Array
    lost: Array
    age: float  # samples, median delay


def needed(found: Innovations, robot: Robot) -> Array:
    """Return the mean effort (k, n) [N m] that the motor equation requires in each interval.

    M_m ddq_m + K zeta + D_m dq_m = B_m u, integrated over the interval: measured minus predicted generalised momenta of
    the motors, as in A. De Luca, R. Mattone, Actuator failure detection and isolation using generalized momenta, ICRA
    2003. The part that the known latency explains is subtracted.
    """
    residual: Array = found.error[:, 3 * robot.n :] @ _effort(robot) / found.dt[:, None]
    return found.sent + residual - foreseen(found)


def foreseen(found: Innovations) -> Array:
    """Return the mean deviation (k, n) [N m] from the sent effort due to the known latency.

    The older effort acts until the command arrives.
    """
    return np.asarray(found.latency[:, None] * (found.older - found.sent))


@lru_cache(maxsize=8)
def _effort(robot: Robot) -> Array:
    """Return (B_m^-1 M_m)' (n, n), which maps accelerations to efforts."""
    return np.asarray(np.linalg.solve(robot.B_m, robot.M_m).T)


class DelaySums:
    """Sums of products of the changes from interval to interval; only changes remove slow disturbances.

    Columns for each joint: required - sent, sent, efforts one sample older less newer (OLDEST of them), measured torque
    at the end and at the start of the interval less sent.
    """

    def __init__(self, n: int) -> None:
        self._products = np.zeros((n, _COLUMNS, _COLUMNS))
        self._measured = True

    def add(self, found: Innovations, required: Array, regular: NDArray[np.bool_]) -> None:
        """Add the regular changes (k - 1,) of intervals that start with a record, or BEFORE the first such change.

        required (k, n) [N m]: effort that the motor equation requires.
        """
        sent = found.sent
        delayed = [_delayed(sent, d) for d in range(thresholds.OLDEST + 1)]
        steps = [older - newer for newer, older in zip(delayed, delayed[1:], strict=False)]
        columns = np.stack([required - sent, sent, *steps, found.after - sent, found.before - sent], axis=2)
        changes = np.diff(columns, axis=0)[regular].transpose(1, 2, 0)
        self._products += changes @ changes.transpose(0, 2, 1)
        self._measured &= bool(np.isfinite(found.after).all() and np.isfinite(found.before).all())

    def delay(self, by_torque: bool = True) -> EffortDelay:
        """Return the input delay that best explains the effort that the motor equation requires.

        by_torque: by the measured torque, too; false: by the motion alone, since the measured torque may be faulty.
        A delay is accepted if it explains more than a factor on each effort, which a wrong motor inertia would make.
        """
        difference, _, *steps, after, before = np.eye(_COLUMNS)
        undelayed = self._square(difference)
        yy, yb, bb = (self._products[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
        explained = np.divide(yb**2, bb, out=np.zeros_like(bb), where=bb > 0)  # by a constant factor on each effort
        scaled = float(np.maximum(yy - explained, 0.0).sum())
        fits = [self._fit(difference - sum(steps[:d], np.zeros(_COLUMNS)), step) for d, step in enumerate(steps)]
        whole = min(range(thresholds.OLDEST), key=lambda d: fits[d][1])
        fraction, left = fits[whole]
        accepted = left < min((1 - thresholds.DELAY_EXPLAINS) * undelayed, scaled)
        if self._measured and by_torque:
            measured, residual = self._fit(difference - after, before - after)
            if residual <= max(thresholds.NO_WORSE * left, thresholds.EXACT * undelayed) or not accepted:
                unmixed, sent = self._square(difference - after), self._square(np.eye(_COLUMNS)[1])
                mixed = residual < (1 - thresholds.HALF_WAY) * unmixed and unmixed > thresholds.NEGLIGIBLE * sent
                return EffortDelay(0, measured if mixed else 0.0, True)
        if not accepted:
            return EffortDelay()
        return EffortDelay(whole + 1) if fraction > 1 - thresholds.EXACT else EffortDelay(whole, fraction)

    def _square(self, of: Array) -> float:
        """Return the sum of squares of a combination of the columns, which rounding may make negative."""
        used = np.flatnonzero(of)
        return max(0.0, float(of[used] @ self._products.sum(axis=0)[np.ix_(used, used)] @ of[used]))

    def _fit(self, y: Array, b: Array) -> tuple[float, float]:
        """Fit the fraction, 0 to 1, of b in y; return it and the residual sum of squares."""
        used = np.flatnonzero((y != 0) | (b != 0))
        products = self._products.sum(axis=0)[np.ix_(used, used)]
        power, shared = float(b[used] @ products @ b[used]), float(b[used] @ products @ y[used])
        fraction = float(np.clip(shared / power, 0.0, 1.0)) if power > 0 else 0.0
        return fraction, self._square(y - fraction * b)


class ActingSums:
    """How many samples old the acting efforts are, if the delay is as given, and whether any acts for part of one."""

    def __init__(self, age: EffortDelay, n: int) -> None:
        self.age = age
        self._counts = np.zeros(BEFORE, dtype=np.int64)
        self._mixed = self._changed = 0.0
        self._largest = np.zeros(n)

    def add(self, found: Innovations, required: Array, regular: NDArray[np.bool_], begin: int) -> None:
        """Add the intervals from `begin` on; otherwise as DelaySums.add."""
        samples, newer, older = _newer(found, self.age, required)
        self._counts += np.bincount(samples[begin:], minlength=BEFORE)
        self._mixed += _squares(required - newer, regular)
        self._changed += _squares(newer - older, regular)
        self._largest = np.maximum(self._largest, np.abs(found.after).max(axis=0, initial=0.0))

    def delayed(self, age: EffortDelay) -> ActingSums:
        """Return these sums for a delay of as many whole samples and any fraction."""
        other = copy(self)
        other.age = age
        return other

    def acting(self, found: Innovations, required: Array) -> Acting:
        """Classify the deviations of the acting effort: saturated by the motor, delayed, or held as one was lost.

        required (k, n) [N m]: effort that the motor equation requires; used if the torque was not measured.
        """
        age = self.age
        samples, newer, older = _newer(found, age, required)
        cut = np.zeros(found.sent.shape, dtype=bool)
        if age.measured:
            cut = _clipped(found.sent, found.after, self._largest)
        whole = self._mixed <= thresholds.MIXED * self._changed  # no change in an interval
        usual = _median(self._counts)
        if not (whole or age.measured or age.late):  # an older effort is nearest by chance
            samples, newer, usual = np.zeros_like(samples), found.sent, 0.0
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


CANDIDATES = (EffortDelay(measured=True), *(EffortDelay(whole) for whole in range(thresholds.OLDEST + 1)))
"""Delays in whole samples; the fraction does not matter to ActingSums."""


def effort_delay(found: Innovations, robot: Robot) -> EffortDelay:
    """Estimate the input delay from the intervals of a record."""
    sums = DelaySums(robot.n)
    sums.add(found, needed(found, robot), regular_changes(found))
    return sums.delay()


def acting(found: Innovations, age: EffortDelay, required: Array) -> Acting:
    """Classify the deviations of the acting effort in the intervals of a record, as ActingSums does."""
    sums = ActingSums(age, found.sent.shape[1])
    sums.add(found, required, regular_changes(found), 0)
    return sums.acting(found, required)


def regular_changes(
    found: Innovations, usual: float | None = None, timed: bool | None = None, begin: int = 0
) -> NDArray[np.bool_]:
    """Return which changes (k - 1,) are between intervals of usual length; all of them unless latencies are known.

    usual [s]: median length, timed: whether latencies are known; None: by these intervals. Left out are
    the changes to intervals before `begin`, and the first OLDEST, whose older efforts are unknown.
    """
    good = np.ones(len(found), dtype=bool)
    if found.latency.any() if timed is None else timed:
        usual = float(np.median(found.dt)) if usual is None else usual
        good &= (np.abs(found.dt - usual) <= thresholds.REGULAR * usual) & (found.latency < 1.0)
    regular = good[1:] & good[:-1]
    regular[: max(begin - 1, thresholds.OLDEST)] = False
    return np.asarray(regular)


def _newer(found: Innovations, age: EffortDelay, required: Array) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the age (k,) of the acting effort in samples, and the efforts (k, n) of that age and one sample older."""
    if age.measured:
        return _samples(found.sent, found.after), found.after, found.before
    samples = age.whole + _samples(found.sent, required, age.whole)
    return samples, _delayed(found.sent, samples), _delayed(found.sent, samples + 1)


def _squares(residual: Array, regular: NDArray[np.bool_]) -> float:
    """Return the sum of squares of the regular changes of a residual (k, n) from interval to interval."""
    return float((np.diff(residual, axis=0)[regular] ** 2).sum())


def _delayed(u: Array, samples: int | NDArray[np.intp]) -> Array:
    """Return efforts (k, n) delayed by `samples`, a number or (k,); the first effort before the start."""
    return u[np.maximum(np.arange(len(u)) - samples, 0)]


def _samples(sent: Array, acting: Array, whole: int = 0) -> NDArray[np.intp]:
    """Return the delay (k,) in samples, beyond `whole`, of the sent effort that equals the acting one; 0: none does."""
    distances = np.array([np.abs(acting - _delayed(sent, whole + j)).max(axis=1) for j in range(thresholds.OLDEST + 1)])
    nearest = np.argmin(distances, axis=0)
    return np.where(distances.min(axis=0) <= thresholds.SAME_OLDER * distances[0], nearest, 0)


def _median(counts: Sequence[int] | NDArray[np.int64]) -> float:
    """Return the median of whole numbers from 0 on that occur `counts` times; 0 if there is none."""
    ends = np.cumsum(counts)
    middle = [np.searchsorted(ends, place, side="right") for place in ((ends[-1] - 1) // 2, ends[-1] // 2)]
    return float(np.mean(middle)) if ends[-1] else 0.0


def _clipped(sent: Array, acting: Array, largest: Array) -> NDArray[np.bool_]:
    """Return where (k, n) the motor is saturated: at its largest torque for CLIPPED_FOR intervals, commanded more."""
    size = np.abs(acting)
    at_most = size >= (1 - thresholds.CLIPPED_LEVEL) * largest
    flags = at_most & (np.abs(sent) > (1 + thresholds.CLIPPED_BY) * size) & (sent * acting > 0)
    kept = np.zeros_like(flags)
    for j, column in enumerate(flags.T):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], column.astype(int), [0]])))
        for start, end in edges.reshape(-1, 2):
            kept[start:end, j] = end - start >= thresholds.CLIPPED_FOR
    return kept
