# SPDX-License-Identifier: Apache-2.0
"""The verdict while the robot runs: blocks of intervals as they come, and what the last ones say together."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import fields
from typing import TypeVar

import numpy as np

from ..control.vdpbc.law import TrackingLaw
from ..numerics.checks import Array
from .cause_errors import CauseErrors, cause_errors, closed_loop
from .delay_estimation import EffortAge, acting, effort_age
from .diagnosis import Verdict, conclude, unknown
from .grading import Axes
from .innovations import needed
from .online_certificate import Forecast
from .storage_budget import Supplies, supplies
from .storage_growth import floor, growth, rises
from .thresholds import BLOCK, OLDEST

BLOCKS = 50  # that a verdict is drawn from: a second at 1 kHz
LOOKED_AT = 200  # intervals in which the age of the effort is looked for
IN_REAL_TIME = 3 * BLOCK  # the same in real time, where answers come a little sooner or later
Blocks = TypeVar("Blocks", Supplies, CauseErrors)
FADING = 0.9  # of what is remembered of how much the effort changed, from verdict to verdict


class RunningVerdict:
    """Judges the intervals of a forecast, a block at a time; the same thresholds as of a record."""

    def __init__(self, law: TrackingLaw, limit: Array, forecast: Forecast, axes: Axes | None = None) -> None:
        """limit (n,) [N m]: of the efforts, inf for none. axes: of the joints, as in `judge`."""
        self._law, self._limit, self._forecast = law, limit, forecast
        self._axes = axes or Axes.plain(law.robot.n)
        self._blocks: deque[tuple[Supplies, CauseErrors, Array]] = deque(maxlen=BLOCKS)
        self._age = EffortAge()
        self.beta = np.inf
        self.forget()

    def use(self, law: TrackingLaw, limit: Array) -> None:
        """Another law or other limits: what was seen says nothing of them."""
        self._law, self._limit = law, limit
        self.forget()

    def forget(self) -> None:
        """Forget all that was seen."""
        self._blocks.clear()
        self._new, self._period, self._change, self._lowest = 0, 0.0, 0.0, np.inf
        self._loop: Array | None = None
        self._state: Array | None = None

    def look(self, beta: float) -> None:
        """There is one more interval; beta [1/s]: the rate to judge it by."""
        self._new += 1
        self.beta = beta
        if self._new == BLOCK:
            self._new = 0
            with np.errstate(all="ignore"):  # as in `judge`
                self._look_for_age()
                self._blocks.append(self._judged(beta))

    def verdict(self) -> Verdict:
        """Return the verdict on the last BLOCKS blocks; estimate the age of the effort anew for the next ones."""
        if not self._blocks:
            return unknown("too few states were answered by the law")
        with np.errstate(all="ignore"):
            return self._concluded()

    def _concluded(self) -> Verdict:
        seen = self._forecast.last(LOOKED_AT)
        self._period, self._change = _usual(seen.dt), FADING * self._change
        if not seen.latency.any():
            self._age = effort_age(seen, self._law.robot)
        self._loop = None  # the robot has moved on
        supplied, made, risen = zip(*self._blocks, strict=True)
        blocks = _together(supplied)
        decay = float(np.exp(-2 * self.beta * BLOCK * self._period))
        grown = growth(np.hstack(risen), floor(blocks, decay, self._axes.storage(self._law)))
        return conclude(blocks, _together(made), grown, decay, self._axes, self._figures())

    def _look_for_age(self) -> None:
        """In real time where the effort turns most: elsewhere its age is lost in answers that come sooner or later."""
        seen = self._forecast.last(IN_REAL_TIME)
        if seen.latency.any():
            change = float((np.diff(seen.sent, 2, axis=0) ** 2).sum())
            if change > self._change:
                self._age, self._change = effort_age(seen, self._law.robot), change

    def _judged(self, beta: float) -> tuple[Supplies, CauseErrors, Array]:
        """Return the last block: supplies of V, errors by cause, and V with the lowest V before it."""
        seen = self._forecast.last(BLOCK + OLDEST)
        acted = acting(seen, self._age, needed(seen, self._law.robot)).last(BLOCK)
        found = seen.rows(slice(-BLOCK, None))
        if not self._period:
            self._period = _usual(found.dt)
        if self._loop is None:
            self._loop = closed_loop(self._law, self._forecast.jets[None, 0], self._period)
        robot, limit = self._law.robot, self._limit
        risen = rises(seen, limit, self._lowest)[:, -BLOCK:]
        self._lowest = float(risen[1, -1])
        made, self._state = cause_errors(found, acted, robot, self._period, limit, self._loop, self._state)
        return supplies(found, acted, robot, beta, self._period, limit), made, risen

    def _figures(self) -> dict[str, float]:
        seen = self._forecast.last(LOOKED_AT)
        samples = self._age.whole + self._age.fraction
        return {"effort age": samples * float(np.median(seen.dt)), "beta": self.beta, "last V": float(seen.V1[-1])}


def _usual(dt: Array) -> float:
    """The sample period [s]: longer than a quarter of the intervals, of which fewer are gaps."""
    return float(np.quantile(dt, 0.25))


def _together(blocks: Sequence[Blocks]) -> Blocks:
    """Return the blocks one after another."""
    joined = {f.name: np.concatenate([getattr(block, f.name) for block in blocks]) for f in fields(blocks[0])}
    return type(blocks[0])(**joined)
