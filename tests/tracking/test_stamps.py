# SPDX-License-Identifier: Apache-2.0
"""Samples that are older than the last, late, doubted or repeated, and gaps."""

from __future__ import annotations

import numpy as np
import pytest

from fjr_core.motions.point_to_point import Hold, standing
from fjr_core.motions.spline import Spline
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import NEVER, State
from fjr_core.runtime.library import constant
from tracking.tracked import LAW, MS, SECOND, SINE, STILL, kinds, sample, settings, tracker_at


def test_older_sample_has_no_command_and_a_repeated_one_the_same_command() -> None:
    tracker = tracker_at(0, 300 * MS)
    newest = tracker.command(sample(300 * MS, 0.4, 0.5), 300 * MS)
    assert tracker.command(sample(200 * MS, 0.4, 0.5), 301 * MS) is None
    again = tracker.command(sample(300 * MS, 0.4, 0.5), 302 * MS)
    assert newest.u == again.u
    assert tracker.counters == {"states older than the last": 1, "states repeated": 2}


def test_one_sample_sent_again_and_again_is_a_silence_until_a_newer_one_comes() -> None:
    tracker, last = running(state_timeout=0.1), SECOND + 200 * MS
    answered = [tracker.command(sample(last, 0.5, 0.5), last + k * MS) is not None for k in range(1, 150)]
    assert answered == [k <= 100 for k in range(1, 150)]
    assert tracker.silence(last + 150 * MS) is not None
    assert tracker.command(sample(last, 0.5, 0.5), last + 151 * MS) is None
    assert tracker.command(sample(last + 160 * MS, 0.5, 0.5), last + 160 * MS) is not None
    assert tracker.counters == {"states repeated": 150, "silences": 1, "recoveries": 1}


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
    assert again.restarted
    np.testing.assert_array_equal(again.jets, SINE.jets(0.0))
    np.testing.assert_array_equal(again.u, tracker_at(0).command(sample(0, 0.5, 0.5), 0).u)
    doubted = {} if before is None else {"jumps doubted": 1}
    assert tracker.counters == {"reference restarts": 1, **doubted}


@pytest.mark.parametrize("moving", [True, False], ids=["on its way", "at its end"])
def test_a_requested_motion_is_not_made_again_on_another_time_line(moving: bool) -> None:
    tracker, now = ControlStep(LAW, Hold([0.0]), settings(start_join_time=0.5, **STILL)), 100 * SECOND
    tracker.command(sample(now, 0.0, 0.0), now)
    tracker.follow(Spline([1.0, 1.9], [[-0.5], [0.8]], start=standing([0.0])), now + MS)
    for k in range(1, 1200 if moving else 2000):
        q, dq = (float(tracker.jets_at(now + k * MS)[i, 0]) for i in range(2))
        tracker.command(sample(now + k * MS, q, q, dq, dq), now + k * MS)
    for k in range(2):
        tracker.command(sample(k * MS, q, q), now + (k + 2000) * MS)
    assert kinds(tracker)[-1] == "reference restarts"
    for t in (0, 500, 1000, 3000):
        np.testing.assert_allclose(tracker.jets_at(t * MS), standing([q]), atol=1e-9)


@pytest.mark.parametrize("jump", [10 * SECOND, -10 * SECOND, -600 * MS])
def test_single_wrong_stamp_changes_nothing(jump: int) -> None:
    tracker, twin = tracker_at(20 * SECOND), tracker_at(20 * SECOND)
    for k in range(1, 5):
        stamp = 20 * SECOND + k * MS
        if k % 2:
            assert tracker.command(sample(stamp + jump, 0.4, 0.5), stamp) is None
            continue
        commands = [t.command(sample(stamp, 0.5, 0.5), stamp) for t in (tracker, twin)]
        np.testing.assert_array_equal(commands[0].u, commands[1].u)
        np.testing.assert_array_equal(commands[0].jets, commands[1].jets)
    assert tracker.counters == {"jumps doubted": 2}


def test_jumps_that_do_not_confirm_each_other_are_ignored_until_a_silence() -> None:
    tracker = tracker_at(SECOND)
    for k, stamp in enumerate((9 * SECOND, 3 * SECOND, 12 * SECOND)):
        assert tracker.command(sample(stamp, 0.5, 0.5), SECOND + k * MS) is None
    assert tracker.silence(2 * SECOND) is not None
    assert tracker.command(sample(30 * SECOND, 0.5, 0.5), 2 * SECOND) is not None
    assert tracker.counters == {"jumps doubted": 3, "silences": 1, "recoveries": 1}


def test_jump_is_confirmed_at_once_in_simulated_time() -> None:
    tracker = ControlStep(LAW, SINE, settings(**STILL), simulated=True)
    tracker.command(sample(20 * SECOND, 0.5, 0.5), 0)
    assert tracker.command(sample(30 * SECOND, 0.5, 0.5), MS) is not None
    assert tracker.command(sample(0, 0.5, 0.5), 2 * MS).restarted
    assert tracker.counters == {"forward jumps": 1, "recoveries": 1, "reference restarts": 1}


def test_in_simulated_time_a_pause_is_no_silence_and_a_short_jump_back_is_a_restart() -> None:
    tracker = ControlStep(LAW, SINE, settings(**STILL), simulated=True)
    for k in range(3):
        assert tracker.command(sample(k * MS, 0.5, 0.5), 10 * k * SECOND) is not None
    assert not tracker.counters["recoveries"]
    assert tracker.command(sample(0, 0.5, 0.5), 20 * SECOND) is None
    assert tracker.command(sample(0, 0.5, 0.5), 21 * SECOND).restarted
    assert tracker.silence(400 * MS) is None
    assert tracker.silence(501 * MS) is not None


WAITING, PAUSE = int(constant("WAITING")), int(constant("PAUSE"))
LATENCY = 200_000  # ns, from stamp to arrival
US = 1000


def running(seconds: float = 0.2, period: int = MS, **given: object) -> ControlStep:
    """Return a tracker that answered samples until `seconds` after SECOND; its clocks differ by LATENCY."""
    tracker = ControlStep(LAW, SINE, settings(**STILL, **given))
    for stamp in range(SECOND, SECOND + round(seconds * 1e9) + 1, period):
        assert tracker.command(sample(stamp, 0.5, 0.5), stamp + LATENCY) is not None
    return tracker


def waits_until(tracker: ControlStep) -> int:
    return int(tracker.lib.fjr_waits_until(tracker.controller))


@pytest.mark.parametrize("hiccup", [0, 4 * MS])
@pytest.mark.parametrize("pause", [50 * MS, 300 * MS, 1000 * MS])
def test_of_the_samples_that_waited_only_the_newest_is_answered(pause: int, hiccup: int) -> None:
    tracker, last = running(), SECOND + 200 * MS
    woken = last + pause + LATENCY
    stamps = range(last + MS, last + pause + 50 * MS, MS)  # the last ones are sent while the first are handed over
    answered = []
    for k, stamp in enumerate(stamps):
        arrival = max(woken + 20 * US * k + (hiccup if k > 20 else 0), stamp + LATENCY)
        if tracker.command(sample(stamp, 0.4, 0.5), arrival) is not None:
            answered.append(arrival - stamp)
    assert len(answered) > 10
    assert all(age <= LATENCY + constant("LATER") for age in answered)
    assert tracker.counters["states stale"] == len(stamps) - len(answered)
    assert tracker.counters["recoveries"] == (pause > 100 * MS)
    assert waits_until(tracker) == NEVER


def test_a_sample_that_waited_is_answered_if_no_newer_one_comes() -> None:
    tracker, stamp = running(), SECOND + 201 * MS
    arrival = stamp + 300 * MS
    assert tracker.command(sample(stamp, 0.4, 0.5), arrival) is None
    assert waits_until(tracker) == arrival + WAITING
    assert tracker.command(sample(stamp, 0.4, 0.5), arrival + WAITING) is not None
    assert waits_until(tracker) == NEVER
    assert "states stale" not in tracker.counters


def test_one_late_sample_does_not_change_the_usual_age() -> None:
    tracker, last = running(), SECOND + 200 * MS
    for stamp, answered in ((last + MS, True), (last + 51 * MS, False)):  # the second may have waited
        assert (tracker.command(sample(stamp, 0.5, 0.5), stamp + 4 * MS) is not None) == answered


def test_a_robot_whose_clock_stood_still_is_answered_after_a_moment() -> None:
    """Its samples come at their own pace, all of them older than before."""
    tracker, last = running(state_timeout=0.5), SECOND + 200 * MS
    answers = [
        tracker.command(sample(last + k * MS, 0.5, 0.5), last + k * MS + 300 * MS) is not None for k in range(1, 51)
    ]
    assert answers.index(True) == WAITING // MS
    assert all(answers[WAITING // MS :])
    assert tracker.state is State.TRACKING
    assert "recoveries" not in tracker.counters


@pytest.mark.parametrize("faster", [10, 1])
def test_a_robot_whose_clock_stood_still_while_a_queue_grew_is_answered_a_moment_after_the_queue_has_gone(
    faster: int,
) -> None:
    """Its states are 300 ms old, `faster` ms less with each further one, until the 20th."""
    tracker, woken, gone = running(state_timeout=0.5), SECOND + 510 * MS, 20
    ages = [(300 - faster * min(k, gone)) * MS for k in range(80)]
    answers = [
        tracker.command(sample(woken + k * MS - age, 0.5, 0.5), woken + k * MS) is not None
        for k, age in enumerate(ages)
    ]
    assert answers.index(True) == gone + WAITING // MS
    assert all(answers[gone + WAITING // MS :])


def test_states_that_queue_are_named_once_until_the_queue_is_empty() -> None:
    tracker, last = running(state_timeout=0.1), SECOND + 200 * MS
    for k in range(1, 1501):  # the queue grows by 0.2 ms a state, and is emptied after the thousandth
        stamp, age = last + k * MS, LATENCY + (k if k <= 1000 else 0) * MS // 5
        assert tracker.command(sample(stamp, 0.5, 0.5), stamp + age) is not None
    assert kinds(tracker).count("states late") == 1
    assert 490 <= tracker.counters["states late"] <= 500


def test_clocks_that_drift_apart_are_no_queue() -> None:
    """500 ppm, as NTP slews at most, for ten minutes: 0.3 s."""
    tracker, period = running(state_timeout=0.1, period=50 * MS), 50 * MS
    for k in range(1, 12_001):
        stamp = SECOND + 200 * MS + k * period
        assert tracker.command(sample(stamp, 0.5, 0.5), stamp + LATENCY + k * period // 2000) is not None
    assert "states late" not in tracker.counters


@pytest.mark.parametrize(("simulated", "pause"), [(False, PAUSE - 1), (True, SECOND)])
def test_slow_samples_of_a_slow_clock_and_all_in_simulated_time_are_answered(simulated: bool, pause: int) -> None:
    """Without a pause before them nothing waits, however much slower than the arrivals the stamps are."""
    tracker = ControlStep(LAW, SINE, settings(**STILL), simulated=simulated)
    for k in range(200):
        assert tracker.command(sample(SECOND + k * MS, 0.5, 0.5), k * pause) is not None


@pytest.mark.parametrize("period", [MS, 50 * MS])
def test_a_gap_longer_than_the_usual_interval_is_a_recovery(period: int) -> None:
    tracker, last = running(0.5, period), SECOND + 500 * MS
    stamp = last + 150 * MS
    assert tracker.command(sample(stamp, 0.5, 0.5), stamp + LATENCY) is not None
    assert tracker.counters["recoveries"] == (period == MS)


def test_a_stop_after_a_gap_names_the_gap() -> None:
    tracker, stamp = running(link_velocity=1.0), SECOND + 500 * MS
    for k, dq in enumerate((0.0, 0.5, 1.5)):
        tracker.command(sample(stamp + k * MS, 0.5, 0.5, dq), stamp + k * MS + LATENCY)
    assert tracker.state is State.STOPPED
    assert "link velocity of joint1: dq_l = 1.5 rad/s; expected at most 1 rad/s" in tracker.reason
    assert tracker.reason.endswith("; 0.002 s before, a gap of 0.3 s without states had ended")


@pytest.mark.parametrize(("stamp", "arrival"), [("later", "later"), ("earlier", "later"), ("later", "now")])
@pytest.mark.parametrize("longest", [0.0, 2.0])
def test_after_a_gap_of_the_arrivals_above_the_longest_the_arm_waits_for_a_resume(
    longest: float, stamp: str, arrival: str
) -> None:
    """Somebody may have reached for it; stamps that jump are no gap, and 0 is no limit."""
    tracker = running(recovery_longest_gap=longest)
    last = SECOND + 200 * MS
    stamps = {"later": last + 3 * SECOND, "earlier": MS}[stamp]
    arrivals = LATENCY + {"later": last + 3 * SECOND, "now": last + MS}[arrival]
    commands = [tracker.command(sample(stamps + k * MS, 0.5, 0.5), arrivals + k * MS) for k in range(3)]
    stops = longest > 0 and arrival == "later"
    assert (commands[-1].state is State.STOPPED) == stops == tracker.counters["stops: silence"]
    if stops:
        assert tracker.reason == (
            "stopped: no new valid state for 3 s; expected at most 2 s (recovery.longest_gap), or ~/resume"
        )
        tracker.resume()
        again = tracker.command(sample(stamps + 3 * MS, 0.5, 0.5), arrivals + 3 * MS)
        assert again.state is State.JOINING


def test_a_resume_during_a_long_gap_does_not_move_the_arm_after_it() -> None:
    tracker, last = running(link_position_upper=1.0, recovery_longest_gap=2.0), SECOND + 200 * MS
    tracker.command(sample(last + MS, 1.5, 1.5), last + MS + LATENCY)
    tracker.resume()
    later = last + 3 * SECOND
    assert tracker.command(sample(later, 0.5, 0.5), later + LATENCY).state is State.STOPPED
    assert tracker.counters["stops: silence"] == 1


def test_outside_names_the_limit_that_keeps_a_stopped_controller_stopped() -> None:
    tracker = running(link_position_upper=1.0)
    stamp = SECOND + 201 * MS
    assert tracker.outside() == ""
    tracker.command(sample(stamp, 4.5, 4.5), stamp + LATENCY)
    assert tracker.outside() == "link position of joint1: q_l = 4.5 rad; expected at most 1 rad"
    tracker.command(sample(stamp + MS, 0.5, 0.5), stamp + MS + LATENCY)
    assert tracker.outside() == ""
    np.testing.assert_equal(tracker.state, State.STOPPED)
