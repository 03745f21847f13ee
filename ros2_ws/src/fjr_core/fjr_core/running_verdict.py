# SPDX-License-Identifier: Apache-2.0
"""The verdict while the robot runs: blocks of intervals as they come, and what the last ones say together."""

from __future__ import annotations

from collections import deque
from dataclasses import fields

import numpy as np

from .checks import Array
from .effort_age import EffortAge, acting, effort_age
from .forecast import Forecast
from .intervals import needed
from .supplies import Supplies, supplies
from .thresholds import BLOCK, GROWN, OLDEST
from .vdpbc.law import TrackingLaw
from .verdict import SAMPLING, Verdict, conclude, unknown, violated

BLOCKS = 50  # that a verdict is drawn from: a second at 1 kHz
LOOKED_AT = 200  # intervals in which the age of the effort is looked for
IN_REAL_TIME = 3 * BLOCK  # the same in real time, where answers come a little sooner or later
FADING = 0.9  # of what is remembered of how much the effort changed, from verdict to verdict


class RunningVerdict:
    """Judges the intervals of a forecast, a block at a time; the same thresholds as of a record."""

    def __init__(self, law: TrackingLaw, limit: Array, forecast: Forecast) -> None:
        """limit (n,) [N m]: of the efforts, inf for none."""
        self._law, self._limit, self._forecast = law, limit, forecast
        self._blocks: deque[Supplies] = deque(maxlen=BLOCKS)
        self._age, self._new, self._period, self._change = EffortAge(), 0, 0.0, 0.0
        self.beta = np.inf

    def use(self, law: TrackingLaw, limit: Array) -> None:
        """Another law or other limits: what was seen says nothing of them."""
        self._law, self._limit = law, limit
        self.forget()

    def forget(self) -> None:
        """Nothing was seen."""
        self._blocks.clear()
        self._new, self._period, self._change = 0, 0.0, 0.0

    def look(self, beta: float) -> None:
        """There is one more interval; beta [1/s]: the rate to judge it by."""
        self._new += 1
        self.beta = beta
        if self._new == BLOCK:
            self._new = 0
            self._look_for_age()
            self._blocks.append(self._judged(beta))

    def verdict(self) -> Verdict:
        """Of the last BLOCKS blocks; looks for the age of the effort anew, for the next ones."""
        seen = self._forecast.last(LOOKED_AT)
        if not self._blocks:
            return unknown("too few states were answered by the law")
        self._period, self._change = _usual(seen.dt), FADING * self._change
        if not seen.latency.any():
            self._age = effort_age(seen, self._law.robot)
        found = conclude(_together(list(self._blocks)), self._figures())
        V = np.array([block.V[0] for block in self._blocks])
        if found.kind == "holding" and len(V) > 2 and V[-1] > GROWN * V[0] and np.mean(np.diff(V) > 0) > 0.75:
            return violated((SAMPLING,), found.figures)
        return found

    def _look_for_age(self) -> None:
        """In real time where the effort turns most: elsewhere its age is lost in answers that come sooner or later."""
        seen = self._forecast.last(IN_REAL_TIME)
        if seen.latency.any():
            change = float((np.diff(seen.sent, 2, axis=0) ** 2).sum())
            if change > self._change:
                self._age, self._change = effort_age(seen, self._law.robot), change

    def _judged(self, beta: float) -> Supplies:
        """The last block, with what acted in it."""
        seen = self._forecast.last(BLOCK + OLDEST)
        acted = acting(seen, self._age, needed(seen, self._law.robot)).last(BLOCK)
        found = seen.rows(slice(-BLOCK, None))
        if not self._period:
            self._period = _usual(found.dt)
        return supplies(found, acted, self._law.robot, beta, self._period, self._limit)

    def _figures(self) -> dict[str, float]:
        seen = self._forecast.last(LOOKED_AT)
        samples = self._age.whole + self._age.fraction
        return {"effort age": samples * float(np.median(seen.dt)), "beta": self.beta, "last V": float(seen.V1[-1])}


def _usual(dt: Array) -> float:
    """The sample period [s]: longer than a quarter of the intervals, of which fewer are gaps."""
    return float(np.quantile(dt, 0.25))


def _together(blocks: list[Supplies]) -> Supplies:
    return Supplies(**{f.name: np.concatenate([getattr(block, f.name) for block in blocks]) for f in fields(Supplies)})
