# SPDX-License-Identifier: Apache-2.0
"""Diagnose the running robot block by block, with the thresholds of the offline diagnosis."""

from __future__ import annotations

from collections import deque

import numpy as np
import numpy.ma  # np.median would load it while the robot moves

from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.monitoring.thresholds import BLOCK, OLDEST, Axes
from fjr_core.numerics.checks import Array

from .cause_errors import CauseErrors, cause_errors, closed_loop
from .delay_estimation import EffortDelay, acting, effort_delay
from .diagnosis import Diagnosis, Judged, unknown
from .innovations import needed
from .online_certificate import OnlineCertificate
from .storage_budget import StorageBudget, storage_budget
from .storage_growth import growth, rises

BLOCKS = 50  # per diagnosis: 1 s at 1 kHz
TOGETHER = 5  # blocks that are processed at once, or fewer for a diagnosis
DELAY_WINDOW = 200  # intervals from which the input delay is estimated
IN_REAL_TIME = 3 * BLOCK  # intervals for the delay in real time, where latency varies
FORGETTING = 0.9  # factor per diagnosis on the largest change of effort so far


class OnlineDiagnosis:
    """Diagnosis of the intervals of an online certificate, one block at a time."""

    def __init__(
        self, law: TrackingLaw, limit: Array, online_certificate: OnlineCertificate, axes: Axes | None = None
    ) -> None:
        """Start without blocks; limit (n,) [N m]: effort limits, inf for none; axes: joints, None: Axes.plain."""
        self._law, self._limit, self._online_certificate = law, limit, online_certificate
        self._axes = axes or Axes.plain(law.robot.n)
        self._blocks: deque[tuple[StorageBudget, CauseErrors, Array]] = deque()
        self._age = EffortDelay()
        self.beta = np.inf
        self.forget()

    def use(self, law: TrackingLaw, limit: Array) -> None:
        """Use another law or other limits and discard the blocks."""
        self._law, self._limit = law, limit
        self.forget()

    def forget(self) -> None:
        """Discard all blocks and estimates."""
        self._blocks.clear()
        self._new, self._period, self._change, self._lowest = 0, 0.0, 0.0, np.inf
        self._loop: Array | None = None
        self._state: Array | None = None

    def look(self, beta: float, count: int = 1) -> None:
        """Process `count` more intervals; beta [1/s]: guaranteed rate of V."""
        self._new += count
        self.beta = beta
        while self._new >= TOGETHER * BLOCK:
            self._process(TOGETHER)

    def verdict(self) -> Diagnosis:
        """Diagnose the last BLOCKS blocks and update the estimate of the input delay for the next ones."""
        if self._new >= BLOCK:
            self._process(self._new // BLOCK)
        if not self._blocks:
            return unknown("too few states with a command of the law")
        with np.errstate(all="ignore"):
            return self._concluded()

    def _concluded(self) -> Diagnosis:
        seen = self._online_certificate.last(DELAY_WINDOW)
        self._period, self._change = _usual(seen.dt), FORGETTING * self._change
        if not seen.latency.any():
            self._age = effort_delay(seen, self._law.robot)
        self._loop = None  # linearise again at the current reference
        risen = [each for _, _, each in self._blocks]
        judged = Judged(float(np.exp(-2 * self.beta * BLOCK * self._period)), self._axes)
        for each in self._blocks:
            judged.add(*each[:2])
        grown = growth(np.hstack(risen), judged.floor(self._axes.storage(self._law)))
        return judged.conclude(grown, self._figures())

    def _estimate_delay(self) -> None:
        """Estimate the delay; in real time only from the largest changes of the effort, since latency varies."""
        seen = self._online_certificate.last(IN_REAL_TIME, self._new)
        if seen.latency.any():
            change = float((np.diff(seen.sent, 2, axis=0) ** 2).sum())
            if change > self._change:
                self._age, self._change = effort_delay(seen, self._law.robot), change

    def _process(self, count: int) -> None:
        """Add the oldest `count` blocks that are not yet processed; keep the last BLOCKS or a few more."""
        self._new -= count * BLOCK
        with np.errstate(all="ignore"):  # as in the offline diagnosis
            self._estimate_delay()
            self._blocks.append(self._latest_blocks(count * BLOCK))
        while sum(len(made[0].hold) for made in self._blocks) - len(self._blocks[0][0].hold) >= BLOCKS:
            self._blocks.popleft()

    def _latest_blocks(self, size: int) -> tuple[StorageBudget, CauseErrors, Array]:
        """Return storage budget and errors by cause of the last `size` intervals, and V with the lowest V before it."""
        seen = self._online_certificate.last(size + OLDEST, self._new)
        acted = acting(seen, self._age, needed(seen, self._law.robot)).rows(slice(-size, None))
        found = seen.rows(slice(-size, None))
        if not self._period:
            self._period = _usual(found.dt)
        if self._loop is None:
            self._loop = closed_loop(self._law, self._online_certificate.jets[None, 0], self._period)
        robot, limit = self._law.robot, self._limit
        risen = rises(seen, limit, self._lowest)[:, -size:]
        self._lowest = float(risen[1, -1])
        made, self._state = cause_errors(found, acted, robot, self._period, limit, self._loop, self._state)
        return storage_budget(found, acted, robot, self.beta, self._period, limit), made, risen

    def _figures(self) -> dict[str, float]:
        seen = self._online_certificate.last(DELAY_WINDOW)
        samples = self._age.whole + self._age.fraction
        return {"effort age": samples * float(np.median(seen.dt)), "beta": self.beta, "last V": float(seen.V1[-1])}


def _usual(dt: Array) -> float:
    """Return the sample period [s]: the lower quartile of the intervals, which gaps do not affect."""
    return float(np.quantile(dt, 0.25))
