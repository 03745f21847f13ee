# SPDX-License-Identifier: Apache-2.0
"""Late and repeated samples, jumps of the stamps, and silences."""

from __future__ import annotations

import numpy as np
import pytest

from fjr_core.runtime.control_step import ControlStep
from tracking.tracked import (
    LAW,
    MS,
    SECOND,
    SINE,
    sample,
    settings,
    tracker_at,
)


def test_older_sample_has_no_command_and_a_repeated_one_the_same_command() -> None:
    tracker = tracker_at(0, 300 * MS)
    newest = tracker.command(sample(300 * MS, 0.4, 0.5), 300 * MS)
    assert tracker.command(sample(200 * MS, 0.4, 0.5), 301 * MS) is None
    again = tracker.command(sample(300 * MS, 0.4, 0.5), 302 * MS)
    assert newest is not None
    assert again is not None
    assert newest.u == again.u
    assert tracker.counters == {"states older than the last": 1, "states repeated": 2}


@pytest.mark.parametrize(
    ("before", "stamp", "arrival"),
    [(299 * MS, 300 * MS, 902 * MS), (300 * MS, 300 * MS, 902 * MS), (None, 890 * MS, 1_500 * MS)],
    ids=["back", "back, repeated", "stale"],
)
def test_another_time_line_starts_the_reference_again(before: int | None, stamp: int, arrival: int) -> None:
    tracker = tracker_at(0, 400 * MS, 900 * MS)
    if before is not None:
        assert tracker.command(sample(before, 0.5, 0.5), arrival - MS) is None
    again = tracker.command(sample(stamp, 0.5, 0.5), arrival)
    assert again is not None
    assert again.restarted
    np.testing.assert_array_equal(again.jets, SINE.jets(0.0))
    np.testing.assert_array_equal(again.u, tracker_at(0).command(sample(0, 0.5, 0.5), 0).u)  # type: ignore[union-attr]
    doubted = {} if before is None else {"jumps doubted": 1}
    assert tracker.counters == {"reference restarts": 1, **doubted}


@pytest.mark.parametrize("jump", [10 * SECOND, -10 * SECOND, -600 * MS])
def test_single_wrong_stamp_changes_nothing(jump: int) -> None:
    tracker, twin = tracker_at(20 * SECOND), tracker_at(20 * SECOND)
    for k in range(1, 5):
        stamp = 20 * SECOND + k * MS
        if k % 2:
            assert tracker.command(sample(stamp + jump, 0.4, 0.5), stamp) is None
            continue
        commands = [t.command(sample(stamp, 0.5, 0.5), stamp) for t in (tracker, twin)]
        np.testing.assert_array_equal(commands[0].u, commands[1].u)  # type: ignore[union-attr]
        np.testing.assert_array_equal(commands[0].jets, commands[1].jets)  # type: ignore[union-attr]
    assert tracker.counters == {"jumps doubted": 2}


def test_jumps_that_do_not_confirm_each_other_are_ignored_until_a_silence() -> None:
    tracker = tracker_at(SECOND)
    for k, stamp in enumerate((9 * SECOND, 3 * SECOND, 12 * SECOND)):
        assert tracker.command(sample(stamp, 0.5, 0.5), SECOND + k * MS) is None
    assert tracker.silence(2 * SECOND) is not None
    assert tracker.command(sample(30 * SECOND, 0.5, 0.5), 2 * SECOND) is not None
    assert tracker.counters == {"jumps doubted": 3, "silences": 1, "recoveries": 1}


def test_jump_is_confirmed_at_once_in_simulated_time() -> None:
    tracker = ControlStep(LAW, SINE, settings(), simulated=True)
    tracker.command(sample(20 * SECOND, 0.5, 0.5), 0)
    assert tracker.command(sample(30 * SECOND, 0.5, 0.5), MS) is not None
    assert tracker.command(sample(0, 0.5, 0.5), 2 * MS).restarted  # type: ignore[union-attr]
    assert tracker.counters == {"forward jumps": 1, "recoveries": 1, "reference restarts": 1}


def test_in_simulated_time_a_pause_is_no_silence_and_a_short_jump_back_is_a_restart() -> None:
    tracker = ControlStep(LAW, SINE, settings(), simulated=True)
    for k in range(3):
        assert tracker.command(sample(k * MS, 0.5, 0.5), 10 * k * SECOND) is not None
    assert not tracker.counters["recoveries"]
    assert tracker.command(sample(0, 0.5, 0.5), 20 * SECOND) is None
    assert tracker.command(sample(0, 0.5, 0.5), 21 * SECOND).restarted  # type: ignore[union-attr]
    assert tracker.silence(400 * MS) is None
    assert tracker.silence(501 * MS) is not None
