# SPDX-License-Identifier: Apache-2.0
"""How old the effort is that acts: what the motor equation needs, regressed on efforts shifted in time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..numerics.checks import Array
from ..robot.robot import Robot
from .innovations import Intervals, needed
from .thresholds import (
    CLIPPED_BY,
    CLIPPED_FOR,
    CLIPPED_LEVEL,
    EXACT,
    EXPLAINED,
    HALF_WAY,
    LATE,
    MIXED,
    NEGLIGIBLE,
    NO_WORSE,
    OLDEST,
    REGULAR,
    SAME_OLDER,
)


@dataclass(frozen=True)
class EffortAge:
    """Which effort acts: `whole` samples late and then for a `fraction` of the interval the one before.

    measured: found from the measured torque, so that `whole` is 0 and any torque may have acted.
    """

    whole: int = 0
    fraction: float = 0.0
    measured: bool = False

    @property
    def late(self) -> bool:
        """Whether it is not the effort sent."""
        return self.whole > 0 or self.fraction > 0


@dataclass(frozen=True)
class Acting:
    """What acted in each interval in place of the effort sent: the difference (k, n) [N m], by its reason."""

    cut: Array
    late: Array
    lost: Array
    age: float  # samples, of most efforts

    def last(self, count: int) -> Acting:
        """Of the last intervals only."""
        return Acting(self.cut[-count:], self.late[-count:], self.lost[-count:], self.age)


def effort_age(found: Intervals, robot: Robot) -> EffortAge:
    """The age that explains best what the motors' equation needs; by changes in time, so that what is slow is out.

    It is believed where it explains more than a factor on each effort does: a motor with another inertia.
    """
    wanted, regular = needed(found, robot), _regular(found)
    nothing = _spread(wanted - found.sent, regular)
    shifted = [_shifted(found.sent, d) for d in range(OLDEST + 1)]
    fits = [_fit(wanted, newer, older, regular) for newer, older in pairwise(shifted)]
    whole = min(range(OLDEST), key=lambda d: fits[d][1])
    fraction, left = fits[whole]
    believed = left < min((1 - EXPLAINED) * nothing, _scaled(wanted, found.sent, regular))
    if np.isfinite(found.after).all() and np.isfinite(found.before).all():
        own, rest = _fit(wanted, found.after, found.before, regular)
        if rest <= max(NO_WORSE * left, EXACT * nothing) or not believed:
            plain = _spread(wanted - found.after, regular)
            mixed = rest < (1 - HALF_WAY) * plain and plain > NEGLIGIBLE * _spread(found.sent, regular)
            return EffortAge(0, own if mixed else 0.0, True)
    if not believed:
        return EffortAge()
    return EffortAge(whole + 1) if fraction > 1 - EXACT else EffortAge(whole, fraction)


def acting(found: Intervals, age: EffortAge, wanted: Array) -> Acting:
    """What acted, sorted: cut off by a limit of the motor, late, or an older one because the newer was lost.

    wanted (k, n) [N m]: what the motors' equation needs, to see from what was not measured.
    """
    if age.measured:
        samples, newer, older = _samples(found.sent, found.after), found.after, found.before
        cut = _clipped(found.sent, found.after)
    else:
        samples, cut = age.whole + _samples(found.sent, wanted, age.whole), np.zeros_like(found.sent, dtype=bool)
        newer, older = (_shifted(found.sent, samples + more) for more in (0, 1))
    regular = _regular(found)
    whole = _spread(wanted - newer, regular) <= MIXED * _spread(newer - older, regular)  # none came within an interval
    if not (whole or age.measured or age.late):  # what is near to an older effort is so by chance
        samples, newer = np.zeros_like(samples), found.sent
    usual = float(np.median(samples)) if len(samples) else 0.0
    total = usual + age.fraction
    difference = (1 - age.fraction) * newer + age.fraction * older - found.sent
    limit = np.inf if not whole else 0.5 if total < LATE else usual + 1.5
    lost = (samples > limit)[:, None] & ~cut
    zero = np.zeros_like(difference)
    return Acting(
        cut=np.where(cut, difference, zero),
        late=np.where(cut | lost, zero, difference),
        lost=np.where(lost, difference, zero),
        age=total,
    )


def _regular(found: Intervals) -> NDArray[np.bool_]:
    """Changes (k - 1,) between intervals of the usual length: all, but in real time, where one of them may be late."""
    if not found.latency.any():
        return np.ones(max(0, len(found) - 1), dtype=bool)
    usual = np.median(found.dt)
    good = (np.abs(found.dt - usual) <= REGULAR * usual) & (found.latency < 1.0)
    return np.asarray(good[1:] & good[:-1])


def _fit(wanted: Array, newer: Array, older: Array, regular: NDArray[np.bool_]) -> tuple[float, float]:
    """The fraction of `older`, 0 to 1, with which the mixture is nearest to what is wanted, and what is left."""
    y, b = _changes(wanted - newer, regular), _changes(older - newer, regular)
    power = float((b * b).sum())
    fraction = float(np.clip((b * y).sum() / power, 0.0, 1.0)) if power > 0 else 0.0
    return fraction, float(((y - fraction * b) ** 2).sum())


def _scaled(wanted: Array, sent: Array, regular: NDArray[np.bool_]) -> float:
    """What is left where each effort is taken times the factor that is nearest to what is wanted."""
    y, b = _changes(wanted, regular), _changes(sent, regular)
    power = (b * b).sum(axis=0)
    factors = np.divide((b * y).sum(axis=0), power, out=np.ones_like(power), where=power > 0)
    return float(((y - factors * b) ** 2).sum())


def _spread(residual: Array, regular: NDArray[np.bool_]) -> float:
    return float((_changes(residual, regular) ** 2).sum())


def _changes(values: Array, regular: NDArray[np.bool_]) -> Array:
    """From interval to interval, but for the first, before which efforts are not known."""
    return np.asarray(np.diff(values, axis=0)[OLDEST:][regular[OLDEST:]])


def _shifted(u: Array, samples: int | NDArray[np.intp]) -> Array:
    """Each effort's predecessor by so many samples, or by its own number of them; the first where there is none."""
    return u[np.maximum(np.arange(len(u)) - samples, 0)]


def _samples(sent: Array, gave: Array, whole: int = 0) -> NDArray[np.intp]:
    """The age (k,) of what the motors gave beyond `whole` samples: back to the effort sent that it is; 0: to none."""
    distances = np.array([np.abs(gave - _shifted(sent, whole + j)).max(axis=1) for j in range(OLDEST + 1)])
    nearest = np.argmin(distances, axis=0)
    return np.where(distances.min(axis=0) <= SAME_OLDER * distances[0], nearest, 0)


def _clipped(sent: Array, gave: Array) -> NDArray[np.bool_]:
    """Where (k, n) the motor gave its most, for some intervals in a row, and was asked for more."""
    size = np.abs(gave)
    at_most = size >= (1 - CLIPPED_LEVEL) * size.max(axis=0, initial=0.0)
    more = (np.abs(sent) > (1 + CLIPPED_BY) * size) & (sent * gave > 0)
    return _runs(at_most & more, CLIPPED_FOR)


def _runs(flags: NDArray[np.bool_], length: int) -> NDArray[np.bool_]:
    """The flags (k, n) that stand in a row of at least `length` along the first axis."""
    kept = np.zeros_like(flags)
    for j, column in enumerate(flags.T):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], column.astype(int), [0]])))
        for start, end in edges.reshape(-1, 2):
            kept[start:end, j] = end - start >= length
    return kept
