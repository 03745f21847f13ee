# SPDX-License-Identifier: Apache-2.0
"""Estimate the input delay by regressing the effort that the motor equation requires on time-shifted commands.

    mean over a block of (required - sent) = mean of (sent some samples before - sent) + noise / duration of the block

The noise of velocities telescopes in a block, so that the least squares of block means, from block to block, is the
likelihood under white noise of the sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Innovations, Table, blocks_of

from . import lost_commands, thresholds

BEFORE = thresholds.OLDEST + 2 + lost_commands.BEFORE + lost_commands.LONGEST
"""Intervals before a part of which the sent efforts may still act in it."""
FEWEST_CHANGES = 20  # blocks into which a short record is divided
AFTER = max(thresholds.CLIPPED_FOR - 1, lost_commands.AFTER)
"""Intervals after a part that decide whether a motor was saturated in it, or a command lost."""
_COLUMNS = thresholds.OLDEST + 4


class EffortDelay(NamedTuple):
    """Input delay: `whole` samples plus a `fraction` of the interval, during which the previous effort acts.

    fraction: beyond the known latency; negative where the effort acts before it. measured: estimated from the measured
    torque; `whole` is then 0. factors (n,): of the measured torque to the effort sent, which a weak motor has; empty:
    not measured.
    """

    whole: int = 0
    fraction: float = 0.0
    measured: bool = False
    factors: tuple[float, ...] = ()


@dataclass(frozen=True)
class Acting(Table):
    """Deviation (k, n) [N m] of the acting effort from the sent one in each interval, by its reason."""

    SHARED: ClassVar[tuple[str, ...]] = ("age",)

    cut: Array
    late: Array
    lost: Array
    missing: NDArray[np.bool_]  # whether the command of the interval (k,) never acted
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
            return EffortDelay(0, measured if mixed else 0.0, True, tuple(map(_factor, products)))
    if not accepted:
        return EffortDelay()
    return EffortDelay(whole + 1) if fraction > 1 - thresholds.EXACT else EffortDelay(whole, fraction)


def _factor(products: Array) -> float:
    """Return the factor of the measured torque to the effort sent; 1 unless it explains their difference, no delay.

    products: of the columns of one joint.
    """
    newest, *steps, after, _ = np.eye(_COLUMNS)[1:]
    delays = (_fit(products, after - sum(steps[:d], np.zeros(_COLUMNS)), step, 0.0)[1] for d, step in enumerate(steps))
    most = min(thresholds.WEAK_LEAVES * _square(products, after), (1 - thresholds.DELAY_EXPLAINS) * min(delays))
    power = _square(products, newest)
    factor = 1 + float(after @ products @ newest) / power if power else 1.0
    weak = abs(factor - 1) > thresholds.CLIPPED_BY and 1 / thresholds.WEAKEST > factor > thresholds.WEAKEST
    return factor if weak and _square(products, after - (factor - 1) * newest) < most else 1.0


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
    """What classifies acting efforts by the measured torque, or by the motion, if the delay is as given."""

    def __init__(self, parts: Sequence[Innovations], age: EffortDelay, robot: Robot) -> None:
        """parts: as of effort_delay."""
        self.age, self._robot = age, robot
        latency = np.concatenate([found.latency for found in parts])
        self._known = float(np.median(latency)) if len(latency) else 0.0
        self._usual, self._sent = float(age.whole), False
        self._largest: Array = np.zeros(robot.n)
        self._noise: Array = np.zeros(robot.n)
        self._period = float(np.median(np.concatenate([found.dt for found in parts]))) if len(latency) else 0.0
        if len(latency) < 2:
            return
        if not age.measured:
            commands, rest = map(np.concatenate, zip(*map(self._unexplained, parts), strict=True))
            self._noise = lost_commands.noise_of(commands, rest)
            return
        found = reduce(Innovations.followed_by, parts)
        newer, older = _measured(found, age)
        efforts = [(each.sent, _measured(each, age)[0]) for each in parts]
        ages = np.concatenate([_samples(*each) for each in efforts])
        exact = np.concatenate([_samples(*each, thresholds.EXACT) > 0 for each in efforts])
        other = ~np.isclose(newer, found.sent, rtol=1e-4).all(axis=1)
        held = np.isclose(newer, older, rtol=1e-9).all(axis=1)  # all through the interval; jitter would end it
        of_sent = 2 * np.count_nonzero(exact) > np.count_nonzero(other)
        self._usual = float(np.median(ages))
        self._sent = bool(of_sent and np.count_nonzero(held & exact) >= thresholds.HELD * np.count_nonzero(exact))
        self._largest = np.abs(found.after).max(axis=0, initial=0.0)

    def acting(self, found: Innovations, begin: int = 0) -> Acting:
        """Classify the deviations of the acting effort: saturated by the motor, delayed, or held as one was lost.

        begin: interval with which a block begins.
        """
        return self._by_torque(found) if self.age.measured else self._by_motion(found, begin)

    def _by_torque(self, found: Innovations) -> Acting:
        """Classify by the measured torque; it tells which command was lost if it is one of the efforts sent."""
        newer, older = _measured(found, self.age)
        total = self._usual + self.age.fraction
        difference = (1 - self.age.fraction) * newer + self.age.fraction * older - found.sent
        limit = np.inf if not self._sent else 0.5 if total < thresholds.LATE else self._usual + 1.5
        cut, missing = _clipped(found.sent, found.after, self._largest), _samples(found.sent, newer) > limit
        lost = missing[:, None] & ~cut
        return Acting(
            cut=np.where(cut, difference, 0.0),
            late=np.where(cut | lost, 0.0, difference),
            lost=np.where(lost, difference, 0.0),
            missing=missing,
            age=total + self._known,
        )

    def _unexplained(self, found: Innovations) -> tuple[Array, Array]:
        """Return the commands (k, n) that act at the end of each interval, and what the motion requires beyond them."""
        u = _delayed(found.sent, self.age.whole)
        return u, needed(found, self._robot) + foreseen(found) - u

    def _by_motion(self, found: Innovations, begin: int) -> Acting:
        """Classify by the effort that the motion requires.

        Of a command that waited for more than a sample the known latency says what acted: it is late.
        """
        whole, fraction = self.age.whole, self.age.fraction
        (u, e), older = self._unexplained(found), _delayed(found.sent, whole + 1)
        share, timed = np.clip(found.latency + fraction, 0.0, 1.0), (found.latency > 0) | (fraction != 0)
        spread = np.maximum(thresholds.UNSURE * timed, unsure(found, self._period))
        missing, before = lost_commands.lost_commands(u, e, share, (self._noise, spread), begin)
        missing &= found.latency < 1.0
        held = np.where(missing, 1.0, share * np.append(False, missing[:-1]))[:, None]
        lost = held * (before - u) - share[:, None] * (older - u) * (held > 0)
        late = (1 - fraction) * u + fraction * older - found.sent
        return Acting(np.zeros_like(lost), late, lost, missing, whole + fraction + self._known)


def regular_intervals(found: Innovations, timed: bool | None = None) -> NDArray[np.bool_]:
    """Return which intervals (k,) are of usual length; all of them unless latencies are known.

    timed: whether they are; None: if any of these intervals has one.
    """
    good = np.ones(len(found), dtype=bool)
    if found.latency.any() if timed is None else timed:
        usual = float(np.median(found.dt))
        good &= (np.abs(found.dt - usual) <= thresholds.REGULAR * usual) & (found.latency < 1.0)
    return good


def _measured(found: Innovations, age: EffortDelay) -> tuple[Array, Array]:
    """Return the efforts (k, n) at the end and at the start of each interval by the measured torque, as commanded."""
    factors = np.asarray(age.factors or 1.0)
    return found.after / factors, found.before / factors


def _delayed(u: Array, samples: int | NDArray[np.intp]) -> Array:
    """Return efforts (k, n) delayed by `samples`, a number or (k,); the first effort before the start."""
    return u[np.maximum(np.arange(len(u)) - samples, 0)]


def _samples(sent: Array, acting: Array, same: float = thresholds.SAME_OLDER) -> NDArray[np.intp]:
    """Return the delay (k,) in samples of the sent effort that equals the acting one; 0: none does.

    same: largest distance of equal efforts, relative to the distance from the newest.
    """
    distances = np.array([np.abs(acting - _delayed(sent, j)).max(axis=1) for j in range(thresholds.OLDEST + 1)])
    nearest = np.argmin(distances, axis=0)
    return np.where(distances.min(axis=0) <= same * distances[0], nearest, 0)


def _clipped(sent: Array, acting: Array, largest: Array) -> NDArray[np.bool_]:
    """Return where (k, n) the motor is saturated: at its largest torque for CLIPPED_FOR intervals, commanded more."""
    size = np.abs(acting)
    at_most = size >= (1 - thresholds.CLIPPED_LEVEL) * largest
    flags = at_most & (np.abs(sent) > (1 + thresholds.CLIPPED_BY) * size) & (sent * acting > 0)
    if not flags.any():
        return flags
    from scipy.ndimage import binary_opening  # 0.3 s of imports

    return np.asarray(binary_opening(flags, np.ones((thresholds.CLIPPED_FOR, 1))))
