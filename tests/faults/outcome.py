# SPDX-License-Identifier: Apache-2.0
"""A row of the table, done and judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from faults.measures import fits
from faults.rig import SECOND, Rig
from faults.rows import Row


@dataclass(frozen=True)
class Outcome:
    """Peak |q_tilde_l| [rad], seconds to recover, efforts seen, how many of them bad, the largest [N m], counters."""

    peak: float
    recovery: float
    efforts: int
    bad: int
    largest: float
    counters: Mapping[str, int]


def outcome(row: Row) -> Outcome:
    """Do what the row says and measure."""
    with Rig(row.setting, row.mode) as rig:
        rig.start_both()
        begin, end = row.act(rig)
        rig.until_stamp(end + SECOND // 10)
        rig.until_calm(1.0 + (row.recovery or 0.0))
        counters = rig.last_report("controller")
        motion, efforts = rig.motion(), rig.efforts()
    largest = max(abs(u) for effort in efforts for u in effort)
    bad = sum(not fits(effort, row.setting.limit) for effort in efforts)
    return Outcome(motion.peak(begin), motion.recovery(end), len(efforts), bad, largest, counters)
