# SPDX-License-Identifier: Apache-2.0
"""Diagnose the running robot block by block, with the thresholds of the offline diagnosis.

The control step in C evaluates certificate and innovations, one state at a time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.ma  # np.median would load it while the robot moves
from numpy.typing import NDArray

from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.motions.reference import JETS
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import CLibrary, record_type
from fjr_monitor.diagnosis import causes
from fjr_monitor.diagnosis.delay_estimation import BEFORE, ActingSums, EffortDelay, effort_delay
from fjr_monitor.diagnosis.record import Innovations, limited
from fjr_monitor.diagnosis.verdict import BlockStatistics, Diagnosis, unknown

from .thresholds import BLOCK, JointTolerances

_FIELDS = {name: name for name in ("dt", "V0", "predicted", "sent", "law", "older", "error", "slope")} | {"V1": "V"}
"""Fields of Innovations, with the names of struct fjr_certified."""
CAPACITY = 640  # intervals; at least the latest half is kept
WINDOW = 1000  # states over which the offset of a clock is estimated
BLOCKS = 50  # per diagnosis: 1 s at 1 kHz
TOGETHER = 5  # blocks that are processed at once, or fewer for a diagnosis
DELAY_WINDOW = 200  # intervals from which the input delay is estimated
IN_REAL_TIME = 3 * BLOCK  # intervals for the delay in real time, where latency varies
EffortLimits = tuple[Array, Array | float]
"""Largest effort (n,) [N m] and its largest rate [N m/s], inf for none."""
FORGETTING = 0.9  # factor per diagnosis on the largest change of effort so far


class LatestIntervals:
    """Innovations of the latest intervals, as certified by the control step; not thread-safe.

    position (2n,) [rad], jets (5, n): latest state and reference. count: number of intervals.
    """

    def __init__(self, n: int, library: CLibrary) -> None:
        """library: the control step of n joints, which defines struct fjr_certified."""
        ffi = library.ffi
        self._n, self.position, self.jets = n, np.zeros(2 * n), np.zeros((JETS, n))
        self._kept: NDArray[Any] = np.zeros(CAPACITY, record_type(ffi, ffi.typeof("struct fjr_certified")))
        self._latencies, self._tracking, self._latency = np.zeros(CAPACITY), np.zeros((CAPACITY, n)), 0.0
        self.forget()

    def forget(self) -> None:
        """Discard the intervals."""
        self.count = 0

    def append(self, certified: NDArray[Any], command: NDArray[Any], latency: Array) -> int:
        """Append the intervals that end at k states, at most CAPACITY / 2; return the number of intervals.

        certified, command (k,): struct fjr_certified and fjr_command of each state; a state that does not follow
        another one ends no interval. latency (k,) [s]: of these commands.
        """
        n, before = self._n, np.append(self._latency, latency[:-1])
        rows: NDArray[np.bool_] = certified["follows"] != 0
        new = int(np.count_nonzero(rows))
        self._latency = float(latency[-1])
        np.copyto(self.position, command["position"][-1])
        np.copyto(self.jets, command["jets"][-1].reshape(self.jets.shape))
        if not new:
            return 0
        if self.count + new > CAPACITY:
            half = CAPACITY // 2
            for kept in (self._kept, self._latencies, self._tracking):
                kept[:half] = kept[self.count - half : self.count].copy()
            self.count = half
        to, plain = slice(self.count, self.count + new), np.dtype((np.void, certified.itemsize))
        self._kept.view(plain)[to] = certified.view(plain)[rows]  # bytes: to copy field by field is slow
        self._latencies[to] = np.minimum(before[rows] / certified["dt"][rows], 1.0)
        self._tracking[to] = command["position"][rows, :n] - command["jets"][rows, :n]
        self.count += new
        return new

    def last(self, count: int, before: int = 0) -> Innovations:
        """Return at most the last `count` intervals, without the `before` latest ones."""
        end = self.count - before
        rows = slice(max(0, end - count), end)
        found = {name: np.ascontiguousarray(self._kept[field][rows]) for name, field in _FIELDS.items()}
        k = len(found["dt"])
        unmeasured = dict.fromkeys(("before", "after"), np.full((k, self._n), np.nan))
        own: dict[str, Any] = {"latency": self._latencies[rows].copy(), "tracking": self._tracking[rows].copy()}
        own |= {"limited": np.zeros((k, self._n), dtype=bool), "answered": np.ones(k, dtype=bool)}
        own |= {"states": np.full((k, 2, 4 * self._n), np.nan), "t": np.full(k, np.nan)}
        return Innovations(**found, **unmeasured, **own)


class OnlineDiagnosis:
    """Diagnosis of the latest intervals, one block at a time."""

    def __init__(
        self, law: TrackingLaw, limits: EffortLimits, intervals: LatestIntervals, axes: JointTolerances | None = None
    ) -> None:
        """Start without blocks; axes: None: JointTolerances.plain."""
        self._law, self._limits, self._intervals = law, limits, intervals
        self._axes = axes or JointTolerances.plain(law.robot.n)
        self._blocks: deque[tuple[causes.StorageBudget, causes.CauseErrors, Array]] = deque()
        self._age = EffortDelay()
        self.beta = np.inf
        self.forget()

    def use(self, law: TrackingLaw, limits: EffortLimits) -> None:
        """Use another law or other limits and discard the blocks."""
        self._law, self._limits = law, limits
        self.forget()

    def forget(self) -> None:
        """Discard all blocks and estimates."""
        self._blocks.clear()
        self._new, self._since, self._period, self._change, self._lowest = 0, 0, 0.0, 0.0, np.inf
        self._propagation = causes.CausePropagation(self._law.robot)

    def look(self, beta: float, count: int = 1) -> None:
        """Process `count` more intervals; beta [1/s]: guaranteed rate of V."""
        self._new += count
        self._since += count
        self.beta = beta
        while self._new >= TOGETHER * BLOCK:
            self._process(TOGETHER)

    def verdict(self) -> Diagnosis:
        """Diagnose the last BLOCKS blocks and update the estimate of the input delay for the next ones."""
        if not self._since:  # since the last verdict: the states, or the commands of the law, have ended
            self.forget()
        self._since = 0
        if self._new >= BLOCK:
            self._process(self._new // BLOCK)
        if not self._blocks:
            return unknown("too few states with a command of the law")
        with np.errstate(all="ignore"):
            seen = self._intervals.last(DELAY_WINDOW)
            self._period, self._change = _usual(seen.dt), FORGETTING * self._change
            if not seen.latency.any():
                self._age = effort_delay([seen], self._law.robot)
            self._propagation.loops = causes.EMPTY  # linearise again at the current reference
            judged = BlockStatistics(float(np.exp(-2 * self.beta * BLOCK * self._period)), self._axes)
            for budget, made, _ in self._blocks:
                judged.add(budget, made)
            risen = np.hstack([each for _, _, each in self._blocks])
            grown = causes.growth(risen, judged.floor(self._axes.storage(self._law)))
            age = float((self._age.whole + self._age.fraction + np.median(seen.latency)) * np.median(seen.dt))
            return judged.conclude(grown, {"effort age": age, "beta": self.beta, "last V": float(seen.V1[-1])})

    def _process(self, count: int) -> None:
        """Add the oldest `count` blocks that are not yet processed; keep the last BLOCKS or a few more.

        In real time the input delay is estimated from the largest changes of the effort only, since latency varies.
        """
        self._new -= count * BLOCK
        with np.errstate(all="ignore"):  # as in the offline diagnosis
            seen = self._intervals.last(IN_REAL_TIME, self._new)
            if seen.latency.any():
                change = float((np.diff(seen.sent, 2, axis=0) ** 2).sum())
                if change > self._change:
                    self._age, self._change = effort_delay([seen], self._law.robot), change
            self._blocks.append(self._latest_blocks(count * BLOCK))
        while sum(len(made[0].hold) for made in self._blocks) - len(self._blocks[0][0].hold) >= BLOCKS:
            self._blocks.popleft()

    def _latest_blocks(self, size: int) -> tuple[causes.StorageBudget, causes.CauseErrors, Array]:
        """Return storage budget and errors by cause of the last `size` intervals, and V with the lowest V before it."""
        seen = self._intervals.last(size + BEFORE, self._new)
        seen = replace(seen, limited=limited(seen.sent, seen.older, seen.dt, *self._limits))
        acting = ActingSums([seen], self._age, self._law.robot).acting(seen, len(seen) - size)
        acted = acting.rows(slice(-size, None))
        found = seen.rows(slice(-size, None))
        if not self._period:
            self._period = _usual(found.dt)
        if not len(self._propagation.loops):
            self._propagation.loops = causes.closed_loop(self._law, self._intervals.jets[None, 0], self._period)
        risen = causes.rises(seen, self._lowest)[:, -size:]
        self._lowest = float(risen[1, -1])
        made = self._propagation.errors(found, acted, self._period)
        return causes.storage_budget(found, acted, self._law.robot, self.beta, self._period), made, risen


def _usual(dt: Array) -> float:
    """Return the sample period [s]: the lower quartile of the intervals, which gaps do not affect."""
    return float(np.quantile(dt, 0.25))


class Latency:
    """Time from each state to its command [s] without the shortest transport delay of a state.

    Arrival minus stamp is the clock offset plus the transport delay. The minimum over the last one to two WINDOWs
    estimates the offset. A constant transport delay cannot be distinguished from the clock offset and is not included;
    variations of the delay are.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Discard the estimate of the clock offset."""
        self._count, self._before, self._least = 0, float("inf"), float("inf")

    def of(self, stamp: int, arrival: int, sent: int) -> float:
        """Return the latency [s] of a state with this stamp, time of arrival and send time of its command [ns].

        arrival and sent are read from the same clock.
        """
        if self._count == WINDOW:
            self._count, self._before, self._least = 0, self._least, float("inf")
        self._count += 1
        self._least = min(self._least, arrival - stamp)
        return (sent - stamp - min(self._before, self._least)) * 1e-9
