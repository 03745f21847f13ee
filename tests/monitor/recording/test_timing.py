# SPDX-License-Identifier: Apache-2.0
"""Missed, late, unanswered and lost samples are counted; distributions of times are exact or of known resolution."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fjr_monitor.recording import timing
from fjr_monitor.recording.timing import Clock, CountedTimes, Counts

MS = 1e-3


def counted(stamps: list[float], answers: list[float], lost: int, split: int, duration: float = 5 * MS) -> Counts:
    """Return the counts of five nominal samples of 1 ms: states at `stamps` [ms], sent at once, commands at `answers`.

    split: number of states in the first of two parts.
    """
    t, clock = MS * np.array(stamps), Clock(MS, lockstep=False)
    clock.add(t[:split], t[:split], MS * np.array(answers[:split]))
    begin = min(2, split)
    late = slice(split - begin, None)
    clock.add(t[late], t[late], MS * np.array(answers[late]), begin)
    return clock.counts(duration, {"/joint_states": lost})


@pytest.mark.parametrize("late", [0.0, 0.3, 0.7, 0.99])
def test_a_run_has_never_more_states_than_nominal_because_its_first_was_late(late: float) -> None:
    stamps = [0.0, *(k - late for k in range(1, 5))]  # times count from the first state
    for count in (5, 6):
        t = [*stamps, 5 - late][:count]
        for duration in (5 * MS, t[-1] * MS + MS):  # as planned, and up to the last state
            kept = [stamp for stamp in t if stamp * MS < duration]
            counts = counted(kept, [stamp + 0.005 for stamp in kept], 0, 2, duration)
            assert counts.published == counts.answered_in_time == counts.nominal == len(kept)
            assert (counts.missing, counts.gaps, counts.late, counts.unanswered) == (0, 0, 0, 0)
            assert counts.answered_in_time_fraction == 1.0


@pytest.mark.parametrize("split", [1, 2, 3])
def test_missed_late_unanswered_and_lost_samples_are_counted(split: int) -> None:
    # 2 is skipped, 1 answered after 3, 3 unanswered
    counts = counted([0, 1, 3, 4], [0.3, 3.2, np.nan, 4.3], 7, split)
    assert (counts.published, counts.missing, counts.gaps) == (4, 1, 1)
    assert (counts.answered, counts.answered_in_time, counts.late, counts.unanswered) == (3, 2, 1, 1)
    assert counts.longest_gap_s == pytest.approx(2 * MS)
    assert counts.published_fraction == pytest.approx(4 / 5)
    assert counts.answered_in_time_fraction == pytest.approx(2 / 4)
    assert counts.lost_by_recorder == {"/joint_states": 7}


@given(st.lists(st.integers(-(10**12), 10**12), min_size=1, max_size=50), st.floats(0, 1), st.integers(0, 50))
def test_quantiles_are_those_of_all_times(times: list[int], share: float, split: int) -> None:
    found = CountedTimes()
    for part in (times[:split], times[split:]):
        found.add(np.array(part, dtype=np.int64))
    assert found.count == len(times)
    assert found.quantile(share) == pytest.approx(np.quantile(times, share), rel=1e-12, abs=1e-3)
    assert (found.least, found.largest) == (min(times), max(times))
    np.testing.assert_allclose(found.above(np.array([0.0])), np.mean(np.array(times) > 0))


def test_a_distribution_of_too_many_different_times_halves_its_resolution(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timing, "MOST", 100)
    times, found = np.random.default_rng(0).integers(10**6, 2 * 10**6, 5000), CountedTimes()
    for part in np.split(times, 10):
        found.add(part)
    assert found.count == 5000
    assert len(found.histogram(np.array([0.0, 1.5e6, 2e6]))) == 2
    assert 1 < found.resolution <= 2**14
    for share in (0.0, 0.1, 0.5, 0.99, 1.0):
        assert 0 <= np.quantile(times, share) - found.quantile(share) <= found.resolution
