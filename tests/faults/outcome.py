# SPDX-License-Identifier: Apache-2.0
"""Run a row of the fault table and measure its outcome."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from faults.fault_rows import Row
from faults.measures import fits
from faults.peers import STATES
from faults.rig import SECOND, STEPPED, Rig

STALL = SECOND // 20  # half of state_timeout: a longer silence is a fault that no row injected
START = 5.0  # s in which nodes that were started track
TRIES = 3


@dataclass(frozen=True)
class Outcome:
    """Peak |q_tilde_l| [rad], recovery time [s], number of efforts and of bad ones, counters.

    counters: of a row that names some, else empty.
    """

    peak: float
    recovery: float
    efforts: int
    bad: int
    counters: Mapping[str, int]


class Pair:
    """A pair of nodes that rows of the same setting and mode disturb one after the other, as each recovers."""

    def __init__(self, executor: str = "") -> None:
        """executor: of both nodes, "" for their default."""
        self._executor = executor
        self._rig: Rig | None = None
        self._before: Counter[str] | None = Counter()  # None: not read since a row changed them

    def outcome(self, row: Row) -> Outcome:
        """Do what the row says and measure; if the machine stood still, again with new nodes, at most TRIES times."""
        for _ in range(TRIES):
            try:
                seen, stalled = self._tried(row, self._rig or self._started(row))
            except BaseException:
                self.close()
                raise
            if stalled or math.isinf(seen.recovery):
                self.close()
            if not stalled:
                break
        return seen

    def close(self) -> None:
        """End the nodes; the next row starts new ones."""
        if self._rig:
            self._rig.close()
        self._rig, self._before = None, Counter()

    def _started(self, row: Row) -> Rig:
        """Return new nodes that track; a machine without time for their start may make the arm stop: then others."""
        for _ in range(TRIES):
            self._rig = rig = Rig(row.setting, row.mode, self._executor)
            rig.start_both()
            if rig.mode == STEPPED:
                break
            rig.until_calm(START)
            if rig.calm:
                break
            self.close()
        else:
            raise AssertionError(f"the nodes did not track within {START} s, {TRIES} times")
        return rig

    def _tried(self, row: Row, rig: Rig) -> tuple[Outcome, bool]:
        if row.counted and self._before is None:
            self._before = Counter(rig.last_report("controller"))
        begin, end = row.act(rig)
        rig.until_stamp(end + SECOND // 10)
        rig.until_calm(1.0 + (row.recovery or 0.0))
        new = self._counted(rig, row)
        motion, efforts, stalled = rig.motion(), rig.efforts(), _stalled(rig, begin, end)
        bad = sum(not fits(effort, row.setting.limit) for effort in efforts)
        rig.forget()
        return Outcome(motion.peak(begin), motion.recovery(end), len(efforts), bad, new), stalled

    def _counted(self, rig: Rig, row: Row) -> Counter[str]:
        """Return what the controller counted in this row, if the row asks for it: a report takes up to a second."""
        before = self._before or Counter()
        self._before = Counter(rig.last_report("controller")) if row.counted else None
        return Counter({name: count - before[name] for name, count in (self._before or {}).items()})


def _stalled(rig: Rig, begin: int, end: int) -> bool:
    """Return whether plant or relay were silent for STALL outside the fault; begin, end: its true stamps."""
    if rig.mode == STEPPED:
        return False
    true = rig.watcher.heard[rig.truth]
    sent = np.array([heard.sent for heard in true])
    first, last = sent[np.searchsorted([heard.stamp for heard in true], [begin, end]).clip(max=len(sent) - 1)]
    gaps = [
        _longest_gap(np.array([heard.sent for heard in rig.watcher.heard[topic]]), first, last)
        for topic in {rig.truth, STATES}
    ]
    return max(gaps) > STALL


def _longest_gap(sent: np.ndarray, first: int, last: int) -> int:
    """Return the longest time [ns] without a message outside the interval from first to last."""
    apart = (sent[1:] < first) | (sent[:-1] > last)
    return int(np.max(np.diff(sent)[apart], initial=0))
