# SPDX-License-Identifier: Apache-2.0
"""Estimate the input delay by regressing the effort that the motor equation requires on time-shifted commands.

    mean over a block of (required - sent) = mean of (sent some samples before - sent) + noise / duration of the block

The noise of velocities telescopes in a block, so that the least squares of block means, from block to block, is the
likelihood under white noise of the sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Innovations, Table, blocks_of

from . import thresholds

BEFORE = 2 * thresholds.OLDEST + 2
"""Intervals before a part of which the sent efforts may still act in it."""
FEWEST_CHANGES = 20  # blocks into which a short record is divided
AFTER = thresholds.CLIPPED_FOR - 1
"""Intervals after a part that decide whether a motor was saturated in it."""
_COLUMNS = thresholds.OLDEST + 4


class EffortDelay(NamedTuple):
    """Input delay: `whole` samples plus a `fraction` of the interval, during which the previous effort acts.

    fraction: beyond the known latency; negative where the effort acts before it. measured: estimated from the measured
    torque; `whole` is then 0.
    """

    whole: int = 0
    fraction: float = 0.0
    measured: bool = False


@dataclass(frozen=True)
class Acting(Table):
    """Deviation (k, n) [N m] of the acting effort from the sent one in each interval, by its reason."""

    SHARED: ClassVar[tuple[str, ...]] = ("age",)

    cut: Array
    late: Array
    lost: Array
    age: float  # samples, median delay with the known latency


def needed(found: Innovations, robot: Robot) -> Array:
    """Return the mean effort (k, n) [N m] that the motor equation requires in each interval.

    M_m ddq_m + K zeta + D_m dq_m = B_m u, integrated over the interval: measured minus predicted generalised momenta of
    the motors, as in A. De Luca, R. Mattone, Actuator failure detection and isolation using generalized momenta, ICRA
    2003. The part that the known latency explains is subtracted.
    """
    residual: Array = found.error[:, 3 * robot.n :] @ np.linalg.solve(robot.B_m, robot.M_m).T / found.dt[:, None]
    return found.sent + residual - foreseen(found)


def foreseen(found: Innovations) -> Array:
    """Return the mean deviation (k, n) [N m] from the sent effort due to the known latency.

    The older effort acts until the command arrives.
    """
    return np.asarray(found.latency[:, None] * (found.older - found.sent))


def unsure(found: Innovations, period: float) -> Array:
    """Return the share (k,) of each interval in which it is unknown which of two efforts acted; 0 without a latency.

    Send times do not reveal when the robot takes over an effort. One that left out states was late with commands, too.
    """
    return np.where(found.dt > thresholds.GAP * period, 1.0, thresholds.UNSURE) * (found.latency > 0)


def effort_delay(
    parts: Sequence[Innovations], robot: Robot, timed: bool | None = None, by_torque: bool = True
) -> EffortDelay:
    """Return the input delay that best explains the effort that the motor equation requires in parts of intervals.

    timed: as of regular_intervals. by_torque: by the measured torque, too; false: by the motion alone, since the
    measured torque may be faulty. A delay is accepted if it explains more than a factor on each effort, which a wrong
    motor inertia would make.
    """
    changes = [_changes(found, robot, timed) for found in parts]
    products = sum((each @ each.transpose(0, 2, 1) for each in changes), np.zeros((robot.n, _COLUMNS, _COLUMNS)))
    total = products.sum(axis=0)
    difference, newest, *steps, after, before = np.eye(_COLUMNS)
    undelayed = _square(total, difference)
    yy, yb, bb = (products[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
    explained = np.divide(yb**2, bb, out=np.zeros_like(bb), where=bb > 0)  # by a constant factor on each effort
    scaled = float(np.maximum(yy - explained, 0.0).sum())
    least = -max(float(found.latency.sum()) / max(1, len(found)) for found in parts)  # no effort acts before its state
    fits = [
        _fit(total, difference - sum(steps[:d], np.zeros(_COLUMNS)), step, 0.0 if d else least)
        for d, step in enumerate(steps)
    ]
    whole = min(range(thresholds.OLDEST), key=lambda d: fits[d][1])
    fraction, left = fits[whole]
    accepted = left < min((1 - thresholds.DELAY_EXPLAINS) * undelayed, scaled)
    if by_torque and all(np.isfinite(found.after).all() and np.isfinite(found.before).all() for found in parts):
        measured, residual = _fit(total, difference - after, before - after, least)
        if residual <= max(thresholds.NO_WORSE * left, thresholds.EXACT * undelayed) or not accepted:
            unmixed, sent = _square(total, difference - after), _square(total, newest)
            mixed = residual < (1 - thresholds.HALF_WAY) * unmixed and unmixed > thresholds.NEGLIGIBLE * sent
            return EffortDelay(0, measured if mixed else 0.0, True)
    if not accepted:
        return EffortDelay()
    return EffortDelay(whole + 1) if fraction > 1 - thresholds.EXACT else EffortDelay(whole, fraction)


def _changes(found: Innovations, robot: Robot, timed: bool | None) -> Array:
    """Return the changes (n, columns, b) from block to block of the means over the regular intervals of each.

    Only changes remove slow disturbances. Columns for each joint: required - sent, sent, efforts one sample older less
    newer (OLDEST of them), measured torque at the end and at the start of the interval less sent. Blocks are shorter
    than BLOCK in a short record.
    """
    sent, required, regular = found.sent, needed(found, robot), regular_intervals(found, timed)
    block = int(np.clip((len(found) - thresholds.OLDEST) // FEWEST_CHANGES, 1, thresholds.BLOCK))
    delayed = [_delayed(sent, d) for d in range(thresholds.OLDEST + 1)]
    steps = [older - newer for newer, older in pairwise(delayed)]
    measured = (np.nan_to_num(each - sent) for each in (found.after, found.before))
    columns = np.stack([required - sent, sent, *steps, *measured], axis=2)
    rows, values = (blocks_of(each[thresholds.OLDEST :], block) for each in (regular, columns))
    share = rows.mean(axis=1)
    with np.errstate(all="ignore"):
        means = np.where(rows[:, :, None, None], values, 0.0).mean(axis=1) / share[:, None, None]
    full = share > 0.5
    return np.asarray(np.diff(means, axis=0)[full[1:] & full[:-1]].transpose(1, 2, 0))


def _square(products: Array, of: Array) -> float:
    """Return the sum of squares of a combination of columns with these products, which rounding may make negative."""
    return max(0.0, float(of @ products @ of))


def _fit(products: Array, y: Array, b: Array, least: float) -> tuple[float, float]:
    """Fit the fraction, `least` to 1, of b in y, combinations of columns; return it and the residual sum of squares."""
    power, shared = float(b @ products @ b), float(b @ products @ y)
    fraction = float(np.clip(shared / power, least, 1.0)) if power > 0 else 0.0
    return fraction, _square(products, y - fraction * b)


class ActingSums:
    """How many samples old the acting efforts are, if the delay is as given, and whether any acts for part of one."""

    def __init__(self, parts: Sequence[Innovations], age: EffortDelay, robot: Robot, timed: bool | None = None) -> None:
        """parts, timed: as of effort_delay."""
        self.age, self._robot = age, robot
        latency = np.concatenate([found.latency for found in parts])
        self._known = float(np.median(latency)) if len(latency) else 0.0
        self._counts = np.zeros(BEFORE, dtype=np.int64)
        self._mixed = self._changed = 0.0
        self._largest = np.zeros(robot.n)
        for found in parts:
            required, regular = needed(found, robot), regular_intervals(found, timed)
            samples, newer, older = _newer(found, age, required)
            changes = regular[1:] & regular[:-1]
            changes[: thresholds.OLDEST] = False
            self._counts += np.bincount(samples, minlength=BEFORE)
            self._mixed += _squares(required - newer, changes)
            self._changed += _squares(newer - older, changes)
            self._largest = np.maximum(self._largest, np.abs(found.after).max(axis=0, initial=0.0))

    def acting(self, found: Innovations) -> Acting:
        """Classify the deviations of the acting effort: saturated by the motor, delayed, or held as one was lost."""
        age = self.age
        samples, newer, older = _newer(found, age, needed(found, self._robot))
        shape = found.sent.shape
        cut = _clipped(found.sent, found.after, self._largest) if age.measured else np.zeros(shape, dtype=bool)
        whole = self._mixed <= thresholds.MIXED * self._changed  # no change in an interval
        ends = np.cumsum(self._counts)
        middle = [np.searchsorted(ends, place, side="right") for place in ((ends[-1] - 1) // 2, ends[-1] // 2)]
        usual = float(np.mean(middle)) if ends[-1] else 0.0  # the median
        if not (whole or age.measured):  # by chance another effort is nearest
            samples, usual = np.full_like(samples, age.whole), float(age.whole)
            newer, older = (_delayed(found.sent, age.whole + later) for later in (0, 1))
        total = usual + age.fraction
        difference = (1 - age.fraction) * newer + age.fraction * older - found.sent
        limit = np.inf if not whole else 0.5 if total < thresholds.LATE else usual + 1.5
        lost = (samples > limit)[:, None] & ~cut
        zero = np.zeros_like(difference)
        return Acting(
            cut=np.where(cut, difference, zero),
            late=np.where(cut | lost, zero, difference),
            lost=np.where(lost, difference, zero),
            age=total + self._known,
        )


def regular_intervals(found: Innovations, timed: bool | None = None) -> NDArray[np.bool_]:
    """Return which intervals (k,) are of usual length; all of them unless latencies are known.

    timed: whether they are; None: if any of these intervals has one.
    """
    good = np.ones(len(found), dtype=bool)
    if found.latency.any() if timed is None else timed:
        usual = float(np.median(found.dt))
        good &= (np.abs(found.dt - usual) <= thresholds.REGULAR * usual) & (found.latency < 1.0)
    return good


def _newer(found: Innovations, age: EffortDelay, required: Array) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the age (k,) of the acting effort in samples, and the efforts (k, n) of that age and one sample older."""
    if age.measured:
        return _samples(found.sent, found.after), found.after, found.before
    samples = age.whole + _samples(found.sent, required, age.whole, thresholds.MOST_LOST)
    return samples, _delayed(found.sent, samples), _delayed(found.sent, samples + 1)


def _squares(residual: Array, regular: NDArray[np.bool_]) -> float:
    """Return the sum of squares of the regular changes of a residual (k, n) from interval to interval."""
    return float((np.diff(residual, axis=0)[regular] ** 2).sum())


def _delayed(u: Array, samples: int | NDArray[np.intp]) -> Array:
    """Return efforts (k, n) delayed by `samples`, a number or (k,); the first effort before the start."""
    return u[np.maximum(np.arange(len(u)) - samples, 0)]


def _samples(sent: Array, acting: Array, whole: int = 0, most: int = thresholds.OLDEST) -> NDArray[np.intp]:
    """Return the delay (k,) in samples, `whole` to `most` more, of the sent effort that equals the acting one.

    0: none does.
    """
    distances = np.array([np.abs(acting - _delayed(sent, whole + j)).max(axis=1) for j in range(most + 1)])
    nearest = np.argmin(distances, axis=0)
    return np.where(distances.min(axis=0) <= thresholds.SAME_OLDER * distances[0], nearest, 0)


def _clipped(sent: Array, acting: Array, largest: Array) -> NDArray[np.bool_]:
    """Return where (k, n) the motor is saturated: at its largest torque for CLIPPED_FOR intervals, commanded more."""
    size = np.abs(acting)
    at_most = size >= (1 - thresholds.CLIPPED_LEVEL) * largest
    flags = at_most & (np.abs(sent) > (1 + thresholds.CLIPPED_BY) * size) & (sent * acting > 0)
    lasting = np.zeros_like(flags)
    if len(flags) >= thresholds.CLIPPED_FOR:
        whole = np.all(sliding_window_view(flags, thresholds.CLIPPED_FOR, axis=0), axis=-1)
        for interval in range(thresholds.CLIPPED_FOR):
            lasting[interval : interval + len(whole)] |= whole
    return lasting
