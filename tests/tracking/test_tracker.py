# SPDX-License-Identifier: Apache-2.0
"""From a sample to an effort: order of the stamps, start, stops, recovery and replacement of the reference."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as effort_spent
from hypothesis import strategies as st

import fjr_core as fjr
from fjr_controller.tracking.bumpless_transfer import smoothstep
from fjr_controller.tracking.events import State
from fjr_controller.tracking.measured_state import OBSERVED
from fjr_controller.tracking.tracker import Tracker
from fjr_core.trajectories.point_to_point import Hold, standing
from fjr_core.trajectories.spline import Spline
from tracking.tracked import PERIOD, TWO_LINK_GAINS, Loop, largest_step, paper_law, sample, settings, two_link_law

MS = 1_000_000
SECOND = 1_000_000_000
SINE = fjr.Sine(1.0, 1.0)
TWO_SINES = fjr.Sine([0.5, 0.7], [2.0, 3.0], [0.3, 0.0])

LAW, SOFT, TWO = paper_law(), paper_law(3.1), two_link_law()
ARMS = {
    "paper": (LAW, SINE, LAW.robot.state(0.0, 0.0, 1.0, 1.0), 0.2),
    "soft": (SOFT, SINE, SOFT.robot.state(0.0, 0.0, 1.0, 1.0), 0.6),
    "two": (TWO, TWO_SINES, TWO.robot.state(0.0, 0.0, 0.0, 0.0), 0.3),
}
"""Law, reference, first state, and the largest step [N m] that an undisturbed recovery is allowed to make."""


def kinds(tracker: Tracker) -> list[str]:
    return [event.kind for event in tracker.events]


# ---- with everything off


@pytest.mark.parametrize("stiffness", [31.0, 3.1])
def test_with_everything_off_the_effort_is_the_law_bit_for_bit(stiffness: float) -> None:
    law = paper_law(stiffness)
    loop = Loop(law, SINE, settings(), law.robot.state(0.5, 0.5, 0.0, 0.0))
    for k in range(300):
        x = loop.x
        dq_l, dq_m = law.robot.velocities(x)
        command = loop.step()
        assert command is not None
        jets = SINE.jets(k * PERIOD * 1e-9)
        u, V = law.measured_command(x[:2], np.concatenate([dq_l, dq_m]), jets)
        assert (command.u == u).all()
        assert command.V == V
        assert (command.jets == jets).all()
        assert command.state is State.TRACKING
    assert not loop.tracker.counters
    assert not loop.tracker.events
    assert loop.tracker.certificate is not None
    assert loop.tracker.certificate.start == SECOND


def test_limits_that_are_not_reached_change_nothing() -> None:
    wide = settings(
        effort=1e3,
        effort_rate=1e9,
        link_position_lower=-9.0,
        motor_position_upper=9.0,
        link_velocity=99.0,
        deflection=9.0,
        tracking_error=9.0,
        start_error=9.0,
        state_timeout=1.0,
    )
    loops = [Loop(LAW, SINE, s, LAW.robot.state(0.0, 0.0, 0.0, 0.0)) for s in (settings(), wide)]
    for loop in loops:
        loop.tracker._efforts.replace(LAW.measured_command(np.zeros(2), np.zeros(2), SINE.jets(0.0))[0])
        loop.run(0.2)
    np.testing.assert_array_equal(loops[0].efforts, loops[1].efforts)


# ---- order of the stamps


def tracker_at(*stamps: int, reference: fjr.Reference = SINE, **given: Any) -> Tracker:
    tracker = Tracker(LAW, reference, settings(**given))
    for stamp in stamps:
        assert tracker.command(sample(stamp, 0.5, 0.5), stamp) is not None
    return tracker


def test_an_older_sample_is_not_answered_and_a_repeated_one_alike() -> None:
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
def test_another_time_line_is_another_beginning(before: int | None, stamp: int, arrival: int) -> None:
    tracker = tracker_at(0, 400 * MS, 900 * MS)
    if before is not None:
        assert tracker.command(sample(before, 0.5, 0.5), arrival - MS) is None
        assert tracker.counters.pop("jumps doubted") == 1
    again = tracker.command(sample(stamp, 0.5, 0.5), arrival)
    assert again is not None
    assert again.restarted
    np.testing.assert_array_equal(again.jets, SINE.jets(0.0))
    np.testing.assert_array_equal(again.u, tracker_at(0).command(sample(0, 0.5, 0.5), 0).u)  # type: ignore[union-attr]
    assert tracker.counters == {"reference restarts": 1}


@pytest.mark.parametrize("jump", [10 * SECOND, -10 * SECOND, -600 * MS])
def test_one_state_with_a_wrong_stamp_changes_nothing(jump: int) -> None:
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


def test_jumps_that_do_not_confirm_each_other_are_doubted_until_a_silence() -> None:
    tracker = tracker_at(SECOND)
    for k, stamp in enumerate((9 * SECOND, 3 * SECOND, 12 * SECOND)):
        assert tracker.command(sample(stamp, 0.5, 0.5), SECOND + k * MS) is None
    assert tracker.silence(2 * SECOND) is not None
    assert tracker.command(sample(30 * SECOND, 0.5, 0.5), 2 * SECOND) is not None
    assert tracker.counters == {"jumps doubted": 3, "silences": 1, "recoveries": 1}


def test_in_simulated_time_a_jump_counts_at_once() -> None:
    tracker = Tracker(LAW, SINE, settings(), simulated_time=True)
    tracker.command(sample(20 * SECOND, 0.5, 0.5), 0)
    assert tracker.command(sample(30 * SECOND, 0.5, 0.5), MS) is not None
    assert tracker.command(sample(0, 0.5, 0.5), 2 * MS).restarted  # type: ignore[union-attr]
    assert tracker.counters == {"forward jumps": 1, "recoveries": 1, "reference restarts": 1}


def test_start_begins_afresh() -> None:
    tracker = tracker_at(0, MS, link_velocity=1.0)
    tracker.command(sample(2 * MS, 0.5, 0.5, 2.0), 2 * MS)
    assert tracker.state is State.STOPPED
    tracker.start()
    assert tracker.state is State.WAITING
    command = tracker.command(sample(SECOND, 0.5, 0.5), SECOND)
    assert command is not None
    np.testing.assert_array_equal(command.jets, SINE.jets(0.0))
    assert command.state is State.TRACKING


@pytest.mark.parametrize("asked", ["nothing", "a trajectory", "a later one", "to hold"])
def test_a_start_leaves_nothing_of_what_was_asked_for(asked: str) -> None:
    tracker = tracker_at(0, 100 * MS)
    if asked == "to hold":
        tracker.hold()
    elif asked != "nothing":
        start = 2 * SECOND if asked == "a later one" else 100 * MS
        tracker.follow(Spline([0.5], [[0.84]], start=SINE.jets(start * 1e-9)), start)
        tracker.command(sample(101 * MS, 0.5, 0.5), 101 * MS)
    tracker.stop_effort()
    tracker.start()
    birth = tracker_at()
    for k in range(5):
        stamp = SECOND + 400 * k * MS
        commands = [t.command(sample(stamp, 2.0, 2.0), stamp) for t in (tracker, birth)]
        np.testing.assert_array_equal(commands[0].jets, commands[1].jets)  # type: ignore[union-attr]
        np.testing.assert_array_equal(commands[0].u, commands[1].u)  # type: ignore[union-attr]


def test_a_start_may_bring_another_reference_and_checks_it() -> None:
    tracker = tracker_at(0, link_velocity=1.0, start_error=0.4)
    tracker.start(Hold([0.3]))
    command = tracker.command(sample(SECOND, 0.5, 0.5), SECOND)
    np.testing.assert_array_equal(command.jets, standing([0.3]))  # type: ignore[union-attr]
    tracker.start()
    command = tracker.command(sample(2 * SECOND, 0.8, 0.8), SECOND)
    np.testing.assert_array_equal(command.jets, standing([0.3]))  # type: ignore[union-attr]
    assert "start refused" in tracker.reason


# ---- silence and recovery


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("quiet", [0.06, 0.4])
def test_after_a_silence_tracking_comes_back_without_a_step(arm: str, policy: str, quiet: float) -> None:
    law, reference, x0, step = ARMS[arm]
    loop = Loop(law, reference, settings(law.robot.n, state_timeout=0.05, on_stop=policy), x0)
    loop.run(1.0)
    assert loop.tracker.silence(loop.now + 48 * MS) is None
    loop.run(0.05, answered=False)
    stop = loop.tracker.silence(loop.now)
    assert stop is not None
    weight = np.linalg.solve(law.robot.B_m, law.robot.grad_P_l(loop.states[999][: law.robot.n]))
    np.testing.assert_allclose(stop, weight if policy == "gravity_hold" else 0.0, rtol=1e-12)
    assert loop.tracker.silence(loop.now + SECOND) is None
    loop.u = stop.copy()
    loop.run(quiet - 0.05, answered=False)
    first = loop.step()
    assert first is not None
    assert first.state is State.JOINING
    np.testing.assert_allclose(first.u, stop, atol=1e-12)
    before = len(loop.efforts) - 1
    loop.run(2.5)
    assert largest_step(loop.efforts[before - 1 :]) < step
    t = (loop.now - PERIOD - SECOND) * 1e-9
    np.testing.assert_allclose(loop.commands[-1].jets, reference.jets(t), rtol=1e-12)
    assert loop.tracker.state is State.TRACKING
    assert loop.error < 2e-3
    assert loop.tracker.counters == {"silences": 1, "recoveries": 1}


def test_a_silence_is_seen_again_after_states_were_back() -> None:
    tracker = tracker_at(0)
    assert tracker.silence(600 * MS) is not None
    tracker.command(sample(700 * MS, 0.5, 0.5), 700 * MS)
    assert tracker.silence(1100 * MS) is None
    assert tracker.silence(1300 * MS) is not None
    assert tracker_at().silence(10 * SECOND) is None


def test_stamps_that_jump_forward_are_a_recovery_too() -> None:
    tracker = tracker_at(0, MS)
    last = tracker.command(sample(2 * MS, 0.5, 0.5), 2 * MS)
    assert tracker.command(sample(5 * SECOND - MS, 0.4, 0.5), 3 * MS) is None
    command = tracker.command(sample(5 * SECOND, 0.4, 0.5), 4 * MS)
    assert last is not None
    assert command is not None
    assert command.state is State.JOINING
    np.testing.assert_allclose(command.u, last.u, atol=1e-12)
    np.testing.assert_allclose(command.jets, standing([0.4]), atol=1e-12)
    assert tracker.counters == {"jumps doubted": 1, "forward jumps": 1, "recoveries": 1}


@pytest.mark.parametrize("ahead", [0, MS])
def test_in_simulated_time_a_silence_that_was_met_ends_with_a_recovery(ahead: int) -> None:
    tracker = Tracker(LAW, SINE, settings(), simulated_time=True)
    tracker.command(sample(SECOND, 0.5, 0.5), 0)
    stop = tracker.silence(2 * SECOND)
    assert stop is not None
    command = tracker.command(sample(SECOND + ahead, 0.5, 0.5), MS)
    assert command is not None
    np.testing.assert_allclose(command.u, stop, atol=1e-12)
    assert command.state is State.JOINING
    assert tracker.counters == {"silences": 1, "recoveries": 1}


def test_a_recovery_does_not_begin_outside_the_limits() -> None:
    tracker = tracker_at(0, link_position_upper=1.0)
    command = tracker.command(sample(SECOND, 1.1, 1.1), SECOND)
    assert "stopped: link position of joint1" in tracker.reason
    np.testing.assert_allclose(command.jets, SINE.jets(1.0), rtol=1e-12)  # type: ignore[union-attr]
    assert "recoveries" not in tracker.counters


def test_without_a_joining_time_tracking_goes_on_at_once() -> None:
    tracker = tracker_at(0, recovery_join_time=0.0)
    command = tracker.command(sample(SECOND, 0.4, 0.5), SECOND)
    assert command is not None
    np.testing.assert_array_equal(command.jets, SINE.jets(1.0))
    assert command.state is State.TRACKING


# ---- start


def test_the_ramp_starts_at_nothing_and_never_falls() -> None:
    tracker = Tracker(LAW, SINE, settings(ramp_time=0.1))
    shares = []
    for k in range(150):
        s = sample(k * MS, 0.5, 0.5)
        command = tracker.command(s, k * MS)
        assert command is not None
        u, _ = LAW.measured_command(np.full(2, 0.5), np.zeros(2), command.jets)
        shares.append(float(command.u[0] / u[0]))
        assert command.state is (State.JOINING if k < 100 else State.TRACKING)
    assert shares[0] == 0.0
    assert (np.diff(shares) >= 0).all()
    assert np.ptp(shares[100:]) == 0.0
    assert shares[100] == 1.0


def test_the_ramp_starts_with_the_effort_of_a_stop() -> None:
    tracker = Tracker(LAW, SINE, settings(ramp_time=0.1, on_stop="gravity_hold"))
    weight = LAW.robot.grad_P_l([0.5])
    for k in range(100):
        command = tracker.command(sample(k * MS, 0.5, 0.5), k * MS)
        assert command is not None
        u, _ = LAW.measured_command(np.full(2, 0.5), np.zeros(2), command.jets)
        s = smoothstep(k / 100)
        np.testing.assert_allclose(command.u, s * u + (1 - s) * weight, rtol=1e-9)


def test_simulated_time_knows_no_pause_but_a_reset_by_less_than_the_timeout() -> None:
    tracker = Tracker(LAW, SINE, settings(), simulated_time=True)
    for k in range(3):
        assert tracker.command(sample(k * MS, 0.5, 0.5), 10 * k * SECOND) is not None
    assert not tracker.counters["recoveries"]
    assert tracker.command(sample(0, 0.5, 0.5), 20 * SECOND) is None
    assert tracker.command(sample(0, 0.5, 0.5), 21 * SECOND).restarted  # type: ignore[union-attr]
    assert tracker.silence(400 * MS) is None
    assert tracker.silence(501 * MS) is not None


def test_smoothstep_is_monotone_and_flat_at_both_ends() -> None:
    s = [smoothstep(k / 1000) for k in range(-10, 1011)]
    assert (np.diff(s) >= 0).all()
    assert (s[0], s[-1]) == (0.0, 1.0)
    assert smoothstep(1e-6) < 1e-11
    assert 1 - smoothstep(1 - 1e-6) < 1e-11


def test_a_start_too_far_from_the_reference_is_refused() -> None:
    for far, q in ((False, 0.5), (True, float(np.nextafter(0.5, 1)))):
        tracker = Tracker(LAW, SINE, settings(start_error=0.5, on_stop="gravity_hold"))
        command = tracker.command(sample(0, q, 0.5), 0)
        assert command is not None
        assert (tracker.state is State.STOPPED) == far
        if far:
            np.testing.assert_allclose(command.u, LAW.robot.grad_P_l([q]), rtol=1e-12)
            assert "joint1 is 0.5 rad; expected at most 0.5 rad" in tracker.reason
            assert kinds(tracker) == ["starts refused"]


def test_a_refused_start_goes_on_by_a_joining_motion_when_resumed() -> None:
    loop = Loop(LAW, SINE, settings(start_error=0.1, on_stop="gravity_hold"), LAW.robot.state(0.5, 0.51, 0.0, 0.0))
    loop.run(0.5)
    assert loop.tracker.state is State.STOPPED
    loop.tracker.resume()
    before = len(loop.efforts)
    loop.run(2.0)
    assert loop.tracker.state is State.TRACKING
    assert loop.error < 1e-3
    assert largest_step(loop.efforts[before - 1 :]) < 0.2


def test_a_refused_start_without_a_joining_time_is_checked_again() -> None:
    tracker = Tracker(LAW, SINE, settings(start_error=0.1, recovery_join_time=0.0))
    tracker.command(sample(0, 0.5, 0.5), 0)
    tracker.resume()
    tracker.command(sample(MS, 0.4, 0.4), MS)
    assert tracker.state is State.STOPPED
    tracker.resume()
    command = tracker.command(sample(2 * MS, 0.05, 0.05), 2 * MS)
    assert command is not None
    assert command.state is State.TRACKING
    np.testing.assert_array_equal(command.jets, SINE.jets(0.0))


def test_a_joining_motion_leads_from_the_first_state_into_the_reference() -> None:
    given = settings(start_error=0.1, start_join_time=0.5, tracking_error=0.1, deflection=0.5)
    x0 = LAW.robot.state(1.0, 1.0 + 0.8 * np.sin(1.0) / 31, 0.0, 0.0)
    loop = Loop(LAW, SINE, given, x0)
    first = loop.step()
    assert first is not None
    np.testing.assert_allclose(first.jets, standing([1.0]), atol=1e-9)
    loop.run(1.0)
    assert loop.tracker.state is State.TRACKING
    np.testing.assert_allclose(loop.commands[500].jets, SINE.jets(0.5), rtol=1e-9)
    assert loop.error < 1e-4


# ---- stops

STATES = {
    "link_position_upper": ("link position", lambda v: (v, 0.0, 0.0, 0.0)),
    "link_position_lower": ("link position", lambda v: (-v, 0.0, 0.0, 0.0)),
    "motor_position_upper": ("motor position", lambda v: (0.0, v, 0.0, 0.0)),
    "motor_position_lower": ("motor position", lambda v: (0.0, -v, 0.0, 0.0)),
    "link_velocity": ("link velocity", lambda v: (0.0, 0.0, -v, 0.0)),
    "motor_velocity": ("motor velocity", lambda v: (0.0, 0.0, 0.0, v)),
    "deflection": ("deflection", lambda v: (0.0, -v, 0.0, 0.0)),
    "tracking_error": ("tracking error", lambda v: (v, 0.0, 0.0, 0.0)),
}


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
@pytest.mark.parametrize("name", STATES)
def test_each_limit_alone_stops_just_beyond_its_value_and_stays(name: str, policy: str) -> None:
    kind, state = STATES[name]
    limit = -0.3 if name.endswith("lower") else 0.3
    tracker = Tracker(LAW, Hold([0.0]), settings(**{name: limit}, on_stop=policy))
    tracker.command(sample(0, 0.0, 0.0), 0)
    tracker.command(sample(MS, *state(0.3)), MS)
    assert tracker.state is State.TRACKING
    beyond = state(float(np.nextafter(0.3, 1)))
    tracker.command(sample(2 * MS, *beyond), 2 * MS)
    assert tracker.state is State.STOPPED
    assert f"{kind} of joint1" in tracker.reason
    tracker.command(sample(2 * MS, *beyond), 2 * MS)
    assert tracker.counters.pop("states repeated") == 1
    assert tracker.counters == {"stops": 1, f"stops: {kind}": 1}
    event = tracker.events.pop()
    assert (event.level, event.values["joint"]) == ("error", "joint1")
    assert abs(float(event.values["limit"])) == 0.3
    for k in range(3, 6):
        command = tracker.command(sample(k * MS, 0.2, 0.2, 0.1, 0.1), k * MS)
        assert command is not None
        expected = 0.8 * np.sin(0.2) - 0.3 * 0.1 if policy == "gravity_hold" else 0.0
        np.testing.assert_allclose(command.u, expected, rtol=1e-12)
        assert np.isnan(command.V)
    assert tracker.certificate is None
    assert tracker.seconds["stopped"] == pytest.approx(4e-3, rel=1e-9)
    tracker.resume()
    resumed = tracker.command(sample(6 * MS, 0.2, 0.2, 0.1, 0.1), 6 * MS)
    assert resumed is not None
    assert resumed.state is State.JOINING
    np.testing.assert_allclose(resumed.u, command.u, atol=1e-12)


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
@pytest.mark.parametrize("arm", ARMS)
def test_a_stopped_arm_resumes_without_a_step(arm: str, policy: str) -> None:
    law, reference, x0, step = ARMS[arm]
    n = law.robot.n
    loop = Loop(law, reference, settings(n, on_stop=policy), x0)
    loop.run(1.0)
    loop.tracker.apply(settings(n, on_stop=policy, link_velocity=1e-3))
    loop.run(0.3)
    assert loop.tracker.state is State.STOPPED
    loop.tracker.apply(settings(n, on_stop=policy))
    loop.run(0.1)
    assert loop.tracker.state is State.STOPPED
    loop.tracker.resume()
    before = len(loop.efforts)
    loop.run(3.0)
    np.testing.assert_allclose(loop.efforts[before], loop.efforts[before - 1], atol=step / 10)
    assert largest_step(loop.efforts[before - 1 :]) < step
    assert loop.tracker.state is State.TRACKING
    assert loop.error < 2e-3


@pytest.mark.parametrize("bad", [float("nan"), 1e153])
@pytest.mark.parametrize("asked", ["resume", "hold", "follow"])
def test_what_is_asked_for_waits_for_a_state_that_is_answered(asked: str, bad: float) -> None:
    trackers = [tracker_at(0, 100 * MS) for _ in range(2)]
    tracker, twin = trackers
    for t in trackers:
        if asked == "resume":
            t.apply(settings(link_velocity=0.1))
            t.command(sample(101 * MS, 0.5, 0.5, 0.2), 101 * MS)
            t.apply(settings())
        if asked == "follow":
            t.follow(Hold([0.2]))
        else:
            getattr(t, asked)()
        t.events.clear()
    before, counters = (tracker.state, tracker.reason), dict(tracker.counters)
    wild = tracker.command(sample(102 * MS, bad, 0.5), 102 * MS)
    assert wild is not None
    assert not wild.u.any()
    assert (tracker.state, tracker.reason) == before
    assert tracker.counters == {**counters, "efforts not finite": 1}
    assert kinds(tracker) == ["efforts not finite"]
    for k in (103, 300):
        commands = [t.command(sample(k * MS, 0.5, 0.5), k * MS) for t in trackers]
        np.testing.assert_array_equal(commands[0].jets, commands[1].jets)  # type: ignore[union-attr]
        assert not tracker.reason


def test_a_recovery_waits_for_a_state_that_is_answered() -> None:
    tracker = tracker_at(0)
    tracker.command(sample(SECOND, 1e153, 0.5), SECOND)
    assert tracker.state is State.TRACKING
    command = tracker.command(sample(SECOND + MS, 0.5, 0.5), SECOND + MS)
    assert command is not None
    np.testing.assert_allclose(command.jets, standing([0.5]), atol=1e-12)
    assert tracker.counters == {"efforts not finite": 1, "recoveries": 1}


@pytest.mark.parametrize("name", ["link_position_upper", "motor_position_lower", "motor_velocity", "deflection"])
def test_a_stop_is_not_resumed_outside_the_limits(name: str) -> None:
    kind, state = STATES[name]
    limit = -0.3 if name.endswith("lower") else 0.3
    tracker = Tracker(LAW, Hold([0.0]), settings(**{name: limit}))
    for k in range(2):
        tracker.command(sample(k * MS, *state(0.4)), k * MS)
        tracker.resume()
    command = tracker.command(sample(2 * MS, *state(0.5)), 2 * MS)
    assert f"{kind} of joint1" in tracker.reason
    assert "0.5" in tracker.reason
    np.testing.assert_array_equal(command.jets, standing([0.0]))  # type: ignore[union-attr]
    assert tracker.counters == {"stops": 3, f"stops: {kind}": 3}
    tracker.command(sample(3 * MS, *state(0.2)), 3 * MS)
    assert tracker.state is State.STOPPED
    tracker.resume()
    tracker.command(sample(4 * MS, *state(0.2)), 4 * MS)
    assert tracker.state is State.JOINING


def test_resume_does_nothing_where_nothing_is_stopped() -> None:
    tracker = tracker_at(0)
    tracker.resume()
    command = tracker.command(sample(MS, 0.5, 0.5), MS)
    assert command is not None
    assert command.state is State.TRACKING
    assert not tracker.counters


@pytest.mark.parametrize("arm", ["paper", "two"])
def test_gravity_hold_holds_an_arm_still(arm: str) -> None:
    law = ARMS[arm][0]
    n = law.robot.n
    q = np.linspace(1.2, -0.6, n)
    zeta = np.linalg.solve(law.robot.K, law.robot.grad_P_l(q))
    far = settings(n, start_error=0.01, on_stop="gravity_hold")
    loop = Loop(law, Hold(np.full(n, 0.3)), far, law.robot.state(q, q + zeta, np.zeros(n), np.zeros(n)))
    loop.run(3.0)
    assert loop.tracker.state is State.STOPPED
    assert np.max(np.abs(loop.x[:n] - q)) < 1e-6


@pytest.mark.parametrize("arm", ["paper", "two"])
def test_gravity_hold_brings_a_moving_arm_to_rest(arm: str) -> None:
    law, reference, x0, _ = ARMS[arm]
    n = law.robot.n
    loop = Loop(law, reference, settings(n, on_stop="gravity_hold"), x0)
    loop.run(1.0)
    loop.tracker.apply(settings(n, on_stop="gravity_hold", link_velocity=0.0))
    loop.run(4.0)
    near = np.max(np.abs(loop.x[:n] - loop.states[1000][:n]))
    assert near < 1.0
    resting = loop.x[:n]
    assert np.max(np.abs(np.concatenate(law.robot.velocities(loop.x)))) < 0.02
    loop.run(0.5)
    assert np.max(np.abs(loop.x[:n] - resting)) < 0.01


def test_the_last_effort_is_within_the_limits() -> None:
    tracker = Tracker(LAW, SINE, settings(effort=0.1, on_stop="gravity_hold"))
    assert not tracker.stop_effort().any()
    tracker.command(sample(0, 0.5, 0.5), 0)
    np.testing.assert_array_equal(tracker.stop_effort(), [0.1])


# ---- efforts


def test_saturation_is_counted_with_its_time() -> None:
    loop = Loop(LAW, SINE, settings(effort=5.0), LAW.robot.state(0.5, 0.5, 0.0, 0.0))
    loop.run(1.0)
    over = sum(abs(u[0]) == 5.0 for u in loop.efforts)
    assert 3 < over < 900
    assert loop.tracker.counters == {"efforts saturated": over, "efforts saturated: joint1": over}
    assert loop.tracker.seconds["in saturation"] == pytest.approx(over * 1e-3, rel=1e-9)
    assert loop.tracker.seconds["in saturation: joint1"] == loop.tracker.seconds["in saturation"]
    assert set(kinds(loop.tracker)) == {"efforts saturated"}
    assert loop.tracker.certificate is not None
    assert loop.tracker.certificate.start > SECOND


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -1e308, 1e200])
def test_an_effort_that_is_not_finite_is_replaced_and_leaves_no_trace(bad: float) -> None:
    tracker = Tracker(LAW, SINE, settings(on_stop="gravity_hold"))
    twin = Tracker(LAW, SINE, settings(on_stop="gravity_hold"))
    for t in (tracker, twin):
        t.command(sample(SECOND, 0.5, 0.5), SECOND)
    for k in (1, 2):
        command = tracker.command(sample(SECOND + k * MS, bad, 0.5, bad), SECOND + k * MS)
        assert command is not None
        np.testing.assert_allclose(command.u, 0.8 * np.sin(0.5), rtol=1e-12)
    good = [t.command(sample(SECOND + 3 * MS, 0.5, 0.5), SECOND + 3 * MS) for t in (tracker, twin)]
    np.testing.assert_array_equal(good[0].u, good[1].u)  # type: ignore[union-attr]
    assert tracker.counters == {"efforts not finite": 2}
    assert kinds(tracker) == ["efforts not finite"]


def test_a_bad_first_sample_does_not_start_the_reference() -> None:
    tracker = Tracker(LAW, SINE, settings())
    command = tracker.command(sample(0, float("nan"), 0.5), 0)
    assert command is not None
    assert not command.u.any()
    assert tracker.state is State.WAITING
    first = tracker.command(sample(100 * MS, 0.5, 0.5), 100 * MS)
    np.testing.assert_array_equal(first.jets, SINE.jets(0.0))  # type: ignore[union-attr]


numbers = st.one_of(
    st.floats(-2, 2), st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e308, -1e308, 1e160, 1e100, 1e9, 5e-324])
)
steps = st.sampled_from([MS, MS, MS, 0, -MS, 5 * MS, 400 * MS, 700 * MS, 10 * SECOND, -300 * MS, -2 * SECOND, 10**18])
samples = st.tuples(steps, steps, *(st.tuples(numbers, numbers),) * 4)
small = st.floats(-0.6, 0.6)
calm = st.tuples(st.just(MS), st.just(MS), *(st.tuples(small, small),) * 4)
acts = st.sampled_from(["silence", "resume", "hold", "follow", "follow later", "start", "use"])
policies = st.sampled_from(["zero", "gravity_hold"])
OTHER = fjr.TrackingLaw(TWO.robot, replace(TWO_LINK_GAINS, Lambda_l=8.0))
OBSERVER = fjr.VelocityObserver(TWO.robot, 150.0)


def act(tracker: Tracker, name: str, stamp: int, arrival: int) -> Any:
    """Do it; the effort that it sends, if any."""
    if name == "silence":
        return tracker.silence(arrival)
    if name == "follow":
        return tracker.follow(Hold([0.1, 0.2]))
    if name == "follow later":
        return tracker.follow(TWO_SINES, stamp + 3 * MS)
    if name == "use":
        return tracker.use(OTHER)
    return getattr(tracker, name)()


@effort_spent(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(st.one_of(calm, calm, calm, samples, acts), max_size=60), policies, st.booleans(), st.booleans())
def test_whatever_comes_efforts_are_finite_and_within_limit_and_rate(
    happenings: list[Any], policy: str, joins: bool, observes: bool
) -> None:
    limit, rate = np.array([3.0, 2.0]), np.array([100.0, 500.0])
    given = settings(
        2,
        effort=limit,
        effort_rate=rate,
        on_stop=policy,
        link_velocity=5.0,
        tracking_error=1.5,
        start_error=1.0,
        ramp_time=0.01,
        start_join_time=0.3 if joins else 0.0,
        recovery_join_time=0.2 if joins else 0.0,
    )
    OBSERVER.reset()
    tracker = Tracker(TWO, TWO_SINES, given, OBSERVER if observes else None)
    stamp = arrival = SECOND
    last, last_stamp = np.zeros(2), None
    for happening in happenings:
        if isinstance(happening, str):
            alone = act(tracker, happening, stamp, arrival)
            if alone is not None:
                assert (np.abs(alone) <= limit).all()
                last = alone.copy()
            continue
        stamp, arrival = stamp + happening[0], arrival + max(happening[1], 0)
        command = tracker.command(sample(stamp, *(np.array(v) for v in happening[2:])), arrival)
        if command is None:
            continue
        assert np.isfinite(command.u).all()
        assert (np.abs(command.u) <= limit).all()
        dt = 0.0 if last_stamp is None else min(max(stamp - last_stamp, 0), SECOND // 2) * 1e-9
        assert (np.abs(command.u - last) <= rate * dt * (1 + 1e-9) + 1e-12).all()
        last, last_stamp = command.u.copy(), stamp
    assert (np.abs(tracker.stop_effort()) <= limit).all()


# ---- gains and certificate


def test_other_gains_act_from_the_next_sample_and_the_certificate_begins_anew() -> None:
    law = LAW.with_gains(replace(fjr.PAPER_GAINS, Lambda_l=5.0))
    loop = Loop(LAW, SINE, settings(), LAW.robot.state(0.5, 0.5, 0.0, 0.0))
    loop.run(0.05)
    old = loop.tracker.certificate
    assert old is not None
    assert (old.start, old.now) == (SECOND, SECOND + 49 * MS)
    assert (old.V0, old.V) == (loop.commands[0].V, loop.commands[-1].V)
    loop.tracker.use(law)
    assert loop.tracker.certificate is None
    x = loop.x
    command = loop.step()
    assert command is not None
    u, V = law.measured_command(x[:2], np.concatenate(law.robot.velocities(x)), command.jets)
    assert command.u == u
    new = loop.tracker.certificate
    assert new is not None
    assert (new.start, new.V0) == (SECOND + 50 * MS, V)
    assert kinds(loop.tracker) == ["gains changed"]


@pytest.mark.parametrize(("name", "value"), [("Pi_l", 1e160), ("Lambda_m", 1e300), ("K_md", 1e170)])
def test_gains_without_a_finite_effort_are_refused_and_the_old_law_stays(name: str, value: float) -> None:
    tracker, twin = tracker_at(0), tracker_at(0)
    law = LAW.with_gains(replace(fjr.PAPER_GAINS, **{name: value}))
    with pytest.raises(fjr.GainsError, match="an effort that is not finite; expected smaller gains"):
        tracker.use(law)
    commands = [t.command(sample(MS, 0.5, 0.5), MS) for t in (tracker, twin)]
    np.testing.assert_array_equal(commands[0].u, commands[1].u)  # type: ignore[union-attr]
    assert not tracker.counters
    with pytest.raises(fjr.GainsError, match="not finite"):
        Tracker(law, SINE, settings())


def test_gains_may_change_after_a_state_that_is_not_finite() -> None:
    tracker = tracker_at(0)
    tracker.command(sample(MS, float("nan"), 0.5), MS)
    tracker.use(LAW.with_gains(replace(fjr.PAPER_GAINS, Lambda_l=5.0)))
    assert "gains changed" in kinds(tracker)


def test_the_bound_of_the_certificate_holds_while_the_law_alone_acts() -> None:
    loop = Loop(LAW, SINE, settings(ramp_time=0.05), LAW.robot.state(0.5, 0.5, 0.0, 0.0))
    loop.run(0.05)
    assert loop.tracker.certificate is None
    beta = LAW.rate().beta
    for _ in range(400):
        loop.step()
        c = loop.tracker.certificate
        assert c is not None
        assert c.start == SECOND + 50 * MS
        bound = c.V0 * np.exp(-2 * beta * (c.now - c.start) * 1e-9)
        assert bound * 1.05 >= c.V


# ---- other references


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("ahead", [None, 0, 100], ids=["at once", "now", "later"])
def test_a_matched_reference_takes_over_without_a_step(arm: str, ahead: int | None) -> None:
    law, reference, x0, step = ARMS[arm]
    loop = Loop(law, reference, settings(law.robot.n), x0)
    loop.run(2.0)
    usual = largest_step(loop.efforts[1900:])
    start = loop.now + (ahead or 0) * MS
    jets = loop.tracker.jets_at(start)
    assert jets is not None
    spline = Spline([1.0], [np.full(law.robot.n, 0.2)], start=jets)
    loop.tracker.follow(spline, None if ahead is None else start)
    before = len(loop.efforts)
    loop.run(1.5)
    switch = before + (ahead or 0)
    assert largest_step(loop.efforts[switch - 1 : switch + 1]) < 1.5 * usual
    assert largest_step(loop.efforts[before - 1 :]) < step
    np.testing.assert_allclose(loop.commands[switch].jets, jets, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(loop.commands[-1].jets, standing(np.full(law.robot.n, 0.2)), atol=1e-12)
    assert loop.error < 2e-3
    assert loop.tracker.end == start + SECOND
    assert loop.tracker.certificate is not None
    assert loop.tracker.certificate.start == SECOND


@pytest.mark.parametrize("arm", ARMS)
def test_a_reference_that_does_not_match_is_joined(arm: str) -> None:
    law, reference, x0, step = ARMS[arm]
    n = law.robot.n
    loop = Loop(law, reference, settings(n), x0)
    loop.run(2.0)
    loop.tracker.follow(fjr.Sine(np.full(n, 0.3), np.full(n, 4.0), np.full(n, -0.2)))
    start = loop.now
    before = len(loop.efforts)
    command = loop.step()
    assert command is not None
    np.testing.assert_allclose(command.jets, reference.jets(2.0), rtol=1e-9, atol=1e-9)
    assert command.state is State.JOINING
    loop.run(2.0)
    assert largest_step(loop.efforts[before - 1 :]) < step
    expected = loop.tracker.jets_at(start + 2 * SECOND)
    np.testing.assert_allclose(expected, fjr.Sine(np.full(n, 0.3), np.full(n, 4.0), np.full(n, -0.2)).jets(2.0))
    assert loop.error < 2e-3


@pytest.mark.parametrize("arm", ARMS)
def test_hold_comes_to_rest_without_a_step_and_stands(arm: str) -> None:
    law, reference, x0, step = ARMS[arm]
    loop = Loop(law, reference, settings(law.robot.n, hold_deceleration=4.0), x0)
    loop.run(2.0)
    jets = reference.jets(2.0)
    time = min(max(float(np.max(np.abs(jets[1]))) / 4.0, 0.2), 2.0)
    loop.tracker.hold()
    before = len(loop.efforts)
    loop.run(time + 1.0)
    assert largest_step(loop.efforts[before - 1 :]) < step
    resting = loop.commands[before + int(time * 1e3) + 1].jets
    np.testing.assert_allclose(resting, standing(jets[0] + jets[1] * time / 2), atol=1e-12)
    np.testing.assert_array_equal(loop.commands[-1].jets, resting)
    assert loop.error < 2e-3


def test_hold_before_the_first_sample_stands_where_the_links_are() -> None:
    tracker = Tracker(LAW, SINE, settings(start_error=0.1))
    tracker.hold()
    command = tracker.command(sample(0, 0.7, 0.7), 0)
    assert command is not None
    np.testing.assert_array_equal(command.jets, standing([0.7]))
    assert command.state is State.TRACKING


def test_hold_while_stopped_keeps_the_arm_where_it_is_when_resumed() -> None:
    tracker = tracker_at(0, link_velocity=1.0)
    tracker.command(sample(MS, 0.5, 0.5, 2.0), MS)
    tracker.hold()
    tracker.command(sample(2 * MS, 0.6, 0.6), 2 * MS)
    tracker.resume()
    for k in (3, 400, 800, 1200, 1500):
        command = tracker.command(sample(k * MS, 0.6, 0.6), k * MS)
        np.testing.assert_allclose(command.jets, standing([0.6]), atol=1e-12)  # type: ignore[union-attr]


def test_a_reference_given_before_the_first_sample_begins_there() -> None:
    tracker = Tracker(LAW, SINE, settings())
    assert tracker.jets_at(0) is None
    tracker.follow(Hold([0.3]))
    command = tracker.command(sample(SECOND, 0.5, 0.5), 0)
    np.testing.assert_array_equal(command.jets, standing([0.3]))  # type: ignore[union-attr]


# ---- observer


class Recorder:
    """An observer that knows the velocities and writes down what it is told; it begins anew after resets only."""

    def __init__(self) -> None:
        self.resets, self.updates = 0, []  # type: ignore[var-annotated]
        self.state = np.array([0.5, 0.5, 0.1, 0.2])
        self._begun, self.fresh = False, True

    def reset(self) -> None:
        self.resets, self._begun = self.resets + 1, False

    def update(self, stamp: int, q_l: Any, q_m: Any, u: Any) -> None:
        self.updates.append((stamp, float(u[0])))
        self.state[:2] = float(q_l[0]), float(q_m[0])
        self.fresh, self._begun = not self._begun, True


def bare_sample(stamp: int, q: float = 0.5) -> Any:
    bare = sample(stamp, q, q)
    bare.dq_l = bare.dq_m = None
    return bare


def test_an_observer_is_fed_with_the_effort_that_was_sent() -> None:
    recorder = Recorder()
    tracker = Tracker(LAW, SINE, settings(effort=1.0), recorder)
    sent = [0.0]
    for k in range(OBSERVED + 3):
        command = tracker.command(bare_sample(k * MS), k * MS)
        assert command is not None
        np.testing.assert_array_equal(command.velocity, [0.1, 0.2])
        sent.append(float(command.u[0]))
    assert recorder.updates == [(k * MS, sent[k]) for k in range(OBSERVED + 3)]
    assert sent[-1]
    tracker.command(bare_sample((OBSERVED + 2) * MS), OBSERVED * MS)
    assert len(recorder.updates) == OBSERVED + 3
    tracker.apply(settings(effort=0.01))
    tracker.command(bare_sample((OBSERVED + 3) * MS), (OBSERVED + 3) * MS)
    assert recorder.updates[-1][1] == sent[-1], "it acted, whatever the limit is since then"


def test_an_observer_begins_anew_after_a_break_and_gets_time_before_its_velocities_count() -> None:
    recorder = Recorder()
    tracker = Tracker(LAW, SINE, settings(), recorder)
    for k in range(OBSERVED + 2):
        tracker.command(sample(k * MS, 0.5, 0.5), k * MS)
    resets = recorder.resets
    stop = tracker.silence(SECOND)
    assert stop is not None
    for k in range(OBSERVED):
        stamp = 2 * SECOND + k * MS
        command = tracker.command(sample(stamp, 0.5, 0.5), stamp)
        assert command is not None
        np.testing.assert_array_equal(command.u, stop)
        assert np.isnan(command.V)
    assert recorder.resets == resets + 1
    stamp = 2 * SECOND + OBSERVED * MS
    command = tracker.command(sample(stamp, 0.5, 0.5), stamp)
    assert command is not None
    assert np.isfinite(command.V)
    np.testing.assert_allclose(command.jets[:2], [[0.5], [0.1]], rtol=1e-9)


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
def test_with_an_observer_a_start_waits_for_the_velocities_with_the_effort_of_a_stop(policy: str) -> None:
    tracker = Tracker(LAW, SINE, settings(on_stop=policy, start_join_time=0.5), Recorder())
    for beginning in (SECOND, 0):  # the second is a jump back
        tracker.command(bare_sample(beginning), 2 * SECOND)  # doubted where it is a jump
        for k in range(1, OBSERVED + 1):
            command = tracker.command(bare_sample(beginning + k * MS), 2 * SECOND)
            assert command is not None
            if k < OBSERVED:
                np.testing.assert_allclose(command.u, LAW.robot.grad_P_l([0.5]) if policy != "zero" else 0.0)
                assert command.state is State.JOINING
                assert np.isnan(command.V)
        if beginning == 0:
            command = tracker.command(bare_sample((OBSERVED + 1) * MS), 2 * SECOND)
        assert np.isfinite(command.V)  # type: ignore[union-attr]
        np.testing.assert_allclose(command.jets[:2], [[0.5], [0.1]], rtol=1e-9)  # type: ignore[union-attr]


def test_repeated_states_are_no_samples_of_the_observer() -> None:
    tracker = Tracker(LAW, Hold([0.0]), settings(), Recorder())
    for k in range(OBSERVED):
        for _ in range(3):
            command = tracker.command(bare_sample(k * MS), k * MS)
            assert not command.u.any()  # type: ignore[union-attr]
    assert tracker.command(bare_sample(OBSERVED * MS), OBSERVED * MS).u.any()  # type: ignore[union-attr]


@pytest.mark.parametrize("name", ["link_position_upper", "motor_position_upper"])
def test_limits_of_positions_hold_while_the_velocities_are_not_known(name: str) -> None:
    tracker = Tracker(LAW, SINE, settings(**{name: 0.6}), Recorder())
    for k in range(OBSERVED + 1):
        tracker.command(bare_sample(k * MS), k * MS)
    for k, q in enumerate((0.5, 0.7)):  # after a silence
        tracker.command(bare_sample(SECOND + k * MS, q), SECOND + k * MS)
    assert STATES[name][0] in tracker.reason


def test_limits_of_velocities_wait_for_the_observer_and_that_of_the_error_for_the_reference() -> None:
    """After a silence the reference is led from where the arm has gone meanwhile."""
    recorder = Recorder()
    tracker = Tracker(LAW, Hold([0.5]), settings(link_velocity=1.0, tracking_error=0.1), recorder)
    for k in range(OBSERVED + 1):
        tracker.command(bare_sample(k * MS), k * MS)
    recorder.state[2] = 2.0  # what a difference of encoder steps may be
    for k in range(OBSERVED + 1):
        recorder.state[2] *= k < OBSERVED - 1
        tracker.command(bare_sample(SECOND + k * MS, 0.9), SECOND + k * MS)
        assert not tracker.reason
    assert tracker.counters["recoveries"] == 1
    recorder.state[2] = 2.0
    stamp = SECOND + (OBSERVED + 1) * MS
    tracker.command(bare_sample(stamp, 0.9), stamp)
    assert "link velocity" in tracker.reason


BREAKS = {
    "a gap": lambda loop: loop.run(0.2, answered=False),
    "a state that is not finite": lambda loop: loop.tracker.command(bare_sample(loop.now - MS // 2, np.nan), loop.now),
    "a silence": lambda loop: loop.run(0.6, answered=False),
}


@pytest.mark.parametrize("stop", BREAKS)
def test_with_an_observer_the_effort_has_no_step_after_it_began_anew(stop: str) -> None:
    loop = Loop(
        LAW, SINE, settings(), LAW.robot.state(0.0, 0.0, 1.0, 1.0), observer=fjr.VelocityObserver(LAW.robot, 150.0)
    )
    loop.run(1.0)
    BREAKS[stop](loop)
    loop.u = loop.tracker._efforts.sent.copy()
    before = len(loop.efforts)
    loop.run(2.0)
    assert largest_step(loop.efforts[before:]) < 0.2
    assert loop.tracker.counters["recoveries"] == 1
    assert loop.tracker.counters["observer restarts"] == (stop != "a silence")
    assert loop.tracker.state is State.TRACKING
    assert loop.error < 2e-3


def test_the_law_sees_no_velocities_of_an_observer_that_are_not_known() -> None:
    x0 = LAW.robot.state(0.0, 0.0, 1.0, 1.0)
    loop = Loop(LAW, SINE, settings(), x0, observer=fjr.VelocityObserver(LAW.robot, 150.0))
    for beginning in (20 * SECOND, SECOND):
        loop.x, loop.now = x0, beginning
        if beginning == SECOND:  # a jump back, whose first sample is doubted
            assert loop.tracker.command(loop.sample(), loop.now) is None
            loop.now += MS
        for k in range(30):
            velocity = np.concatenate(LAW.robot.velocities(loop.x))
            command = loop.step()
            assert command is not None
            if np.isfinite(command.V):
                np.testing.assert_allclose(command.velocity, velocity, atol=0.05)
            assert np.isfinite(command.V) == (k >= OBSERVED)


def test_no_velocities_and_no_observer_is_said() -> None:
    bare = sample(0, 0.5, 0.5)
    bare.dq_l = None
    with pytest.raises(fjr.StateError, match="no velocities; expected them, or an observer"):
        tracker_at().command(bare, 0)
