# SPDX-License-Identifier: Apache-2.0
"""Missed, late, unanswered and lost samples are counted."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fjr_monitor.recording.bag import Bag
from fjr_monitor.recording.files import Topic
from fjr_monitor.report.performance import Counts, counts

PERIOD = 1e-3


def counted(stamps: list[float], answers: list[float], lost: int, duration: float = 5 * PERIOD) -> Counts:
    """Return the counts of five nominal samples of 1 ms: states at `stamps` [ms], sent at once, commands at `answers`.

    An answer of -1 stands for none.
    """
    t, answered = (np.array([round(1e6 * each) if each >= 0 else -1 for each in given]) for given in (stamps, answers))
    bag, signals = Bag(Path(), {"/joint_states": Topic("", "", "", lost=lost)}, True), SimpleNamespace(stamp=t, sent=t)
    signals.answered = answered
    run = SimpleNamespace(signals=signals, sample_period=PERIOD, lockstep=False, bag=bag)
    return counts(run, duration)  # type: ignore[arg-type]


@pytest.mark.parametrize("late", [0.0, 0.3, 0.7, 0.99])
def test_a_run_has_never_more_states_than_nominal_because_its_first_was_late(late: float) -> None:
    stamps = [0.0, *(k - late for k in range(1, 5))]  # times count from the first state
    for count in (5, 6):
        t = [*stamps, 5 - late][:count]
        for duration in (5 * PERIOD, t[-1] * PERIOD + PERIOD):  # as planned, and up to the last state
            kept = [stamp for stamp in t if stamp * PERIOD < duration]
            counts = counted(kept, [stamp + 0.005 for stamp in kept], 0, duration)
            assert counts.published == counts.answered_in_time == counts.nominal == len(kept)
            assert (counts.missing, counts.gaps, counts.late, counts.unanswered) == (0, 0, 0, 0)
            assert counts.answered_in_time_fraction == 1.0


def test_missed_late_unanswered_and_lost_samples_are_counted() -> None:
    # 2 is skipped, 1 answered after 3, 3 unanswered
    counts = counted([0, 1, 3, 4], [0.3, 3.2, -1, 4.3], 7)
    assert (counts.published, counts.missing, counts.gaps) == (4, 1, 1)
    assert (counts.answered, counts.answered_in_time, counts.late, counts.unanswered) == (3, 2, 1, 1)
    assert counts.longest_gap_s == pytest.approx(2 * PERIOD)
    assert counts.published_fraction == pytest.approx(4 / 5)
    assert counts.answered_in_time_fraction == pytest.approx(2 / 4)
    assert counts.lost_by_recorder == {"/joint_states": 7}
