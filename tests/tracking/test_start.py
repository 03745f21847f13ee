# SPDX-License-Identifier: Apache-2.0
"""Starts, stops at limits and recoveries: nothing steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np
import pytest

from fjr_core.motions.point_to_point import Hold, standing
from fjr_core.motions.spline import Spline
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from fjr_core.runtime.safety_settings import REACTIONS, Settings
from fjr_core.runtime.velocity_observer import VelocityObserver
from tracking.tracked import (
    LAW,
    LIMITED,
    MS,
    PERIOD,
    SECOND,
    SINE,
    STEP,
    STILL,
    TWO,
    TWO_SINES,
    Loop,
    kinds,
    largest_step,
    moving_arm,
    sample,
    settings,
    tracker_at,
)


@pytest.mark.parametrize("requested", ["nothing", "a trajectory", "a later one", "to hold", "to resume after a stop"])
def test_a_start_discards_pending_requests_and_stops_and_starts_the_reference_again(requested: str) -> None:
    tracker = tracker_at(0, 100 * MS)
    if requested == "to hold":
        tracker.hold()
    elif requested == "to resume after a stop":
        tracker.apply(settings(**STILL, link_velocity=1.0))
        tracker.command(sample(101 * MS, 0.5, 0.5, 2.0), 101 * MS)
        assert tracker.state is State.STOPPED
        tracker.resume()
        tracker.apply(settings(**STILL))
    elif requested != "nothing":
        start = 2 * SECOND if requested == "a later one" else 100 * MS
        tracker.follow(Spline([0.5], [[0.84]], start=SINE.jets(start * 1e-9)), start)
        tracker.command(sample(101 * MS, 0.5, 0.5), 101 * MS)
    tracker.stop_effort()
    tracker.start()
    birth = tracker_at()
    for k in range(5):
        stamp = SECOND + 400 * k * MS
        commands = [t.command(sample(stamp, 2.0, 2.0), stamp) for t in (tracker, birth)]
        np.testing.assert_array_equal(commands[0].jets, commands[1].jets)
        np.testing.assert_array_equal(commands[0].u, commands[1].u)


def live(tracker: ControlStep, rng: np.random.Generator) -> int:
    """Let a tracker have a random past of states, silences, jumps, requests and contacts; return its last stamp."""
    now, arrival, joints = SECOND, 5 * SECOND, tracker.settings.n
    for _ in range(rng.integers(60)):
        event = rng.choice(["states"] * 4 + ["pause", "jump", "broken", "hold", "follow", "resume", "contact", "stop"])
        if event == "states":
            for q, dq in rng.normal([0.3, 0.0], [0.3, 1.0], (rng.integers(1, 40), joints, 2)).swapaxes(1, 2):
                now, arrival = now + PERIOD, arrival + PERIOD
                tracker.command(sample(now, q, q + 0.01, dq, dq), arrival)
                tracker.check_wiring()
        elif event == "pause":
            pause = int(rng.choice([50, 300])) * MS
            now, arrival = now + pause, arrival + pause
            tracker.silence(arrival)
        elif event == "jump":
            now += int(rng.integers(6)) * SECOND
        elif event == "broken":
            tracker.command(sample(now + 1, np.full(joints, np.nan), 0.0), arrival)
        elif event == "follow":
            tracker.follow(Hold(np.full(joints, 0.1)), [None, now, now + SECOND][rng.integers(3)])
        elif event == "contact":
            tracker.controller.contact.acting = rng.integers(2)
        elif event == "stop":
            tracker.command(sample(now, np.full(joints, 9.0), 9.0), arrival)
        else:
            getattr(tracker, event)()
    return now


@pytest.mark.parametrize("observed", [False, True], ids=["measured", "observed"])
@pytest.mark.parametrize("seed", range(10))
def test_a_controller_that_starts_again_is_a_new_one_whatever_its_past(seed: int, observed: bool) -> None:
    """Commands and events of its next states are those of a controller without a past."""
    rng = np.random.default_rng(seed)
    more = {"ramp_time": rng.choice([0.0, 0.05]), "start_join_time": rng.choice([0.0, 0.3]), "effort": 5.0}
    given = settings(2, state_timeout=0.1, link_position_upper=3.0, on_contact=rng.choice(REACTIONS), **more)
    observer = VelocityObserver(TWO.robot, 200.0) if observed else None
    old, new = (ControlStep(TWO, TWO_SINES, given, observer=observer) for _ in range(2))
    stamp = live(old, rng) + int(rng.choice([0, MS, 20 * SECOND]))
    old.stop_effort()
    old.start()
    old.events.clear()
    dq = rng.normal(size=2)
    for k in range(60):
        q = 0.05 + dq * k * 1e-3
        commands = [t.command(sample(stamp + k * MS, q, q, dq, dq), 60 * SECOND + k * MS) for t in (old, new)]
        np.testing.assert_equal(*map(asdict, commands))
    assert [event.sentence for event in old.events] == [event.sentence for event in new.events]


def test_a_start_with_another_reference_checks_it() -> None:
    tracker = tracker_at(0, link_velocity=1.0, start_error=0.4)
    tracker.start(Hold([0.3]))
    command = tracker.command(sample(SECOND, 0.5, 0.5), SECOND)
    np.testing.assert_array_equal(command.jets, standing([0.3]))
    tracker.start()
    command = tracker.command(sample(2 * SECOND, 0.8, 0.8), SECOND)
    np.testing.assert_array_equal(command.jets, standing([0.3]))
    assert "start refused" in tracker.reason


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
def test_the_ramp_goes_from_the_effort_of_a_stop_to_that_of_the_law_as_a_smoothstep(policy: str) -> None:
    tracker = ControlStep(LAW, SINE, settings(ramp_time=0.1, on_stop=policy, **STILL))
    weight = LAW.robot.grad_P_l([0.5]) if policy == "gravity_hold" else 0.0
    for k in range(150):
        command = tracker.command(sample(k * MS, 0.5, 0.5), k * MS)
        u, _ = LAW.measured_command(np.full(2, 0.5), np.zeros(2), command.jets)
        t = min(k / 100, 1.0)
        s = 3 * t**2 - 2 * t**3
        np.testing.assert_allclose(command.u, s * u + (1 - s) * weight, rtol=1e-9)
        assert command.state is (State.JOINING if k < 100 else State.TRACKING)


def test_a_start_by_a_transition_without_a_ramp_begins_at_the_last_effort() -> None:
    tracker = tracker_at(on_stop="gravity_hold", start_join_time=0.5)
    np.testing.assert_allclose(tracker.command(sample(0, 0.5, 0.5), 0).u, 0.0, atol=1e-12)


def test_a_start_too_far_from_the_reference_is_refused() -> None:
    for far, q in ((False, 0.5), (True, float(np.nextafter(0.5, 1)))):
        tracker = ControlStep(LAW, SINE, settings(start_error=0.5, on_stop="gravity_hold"))
        command = tracker.command(sample(0, q, 0.5), 0)
        assert (tracker.state is State.STOPPED) == far
        if far:
            np.testing.assert_allclose(command.u, LAW.robot.grad_P_l([q]), rtol=1e-12)
            assert "joint1 is 0.5 rad; expected at most 0.5 rad" in tracker.reason
            assert kinds(tracker) == ["starts refused"]
            tracker.resume()
            assert tracker.command(sample(MS, q, 0.5), MS).state is State.JOINING


def test_a_refused_start_without_a_joining_time_is_checked_again() -> None:
    tracker = ControlStep(LAW, SINE, settings(start_error=0.1, recovery_join_time=0.0))
    tracker.command(sample(0, 0.5, 0.5), 0)
    tracker.resume()
    tracker.command(sample(MS, 0.4, 0.4), MS)
    assert tracker.state is State.STOPPED
    tracker.resume()
    command = tracker.command(sample(2 * MS, 0.05, 0.05), 2 * MS)
    assert command.state is State.TRACKING
    np.testing.assert_array_equal(command.jets, SINE.jets(0.0))


def stopped(loop: Loop, given: Settings) -> dict[str, int]:
    """Stop at a limit that is lifted again, and ask to resume; return the counters."""
    loop.tracker.apply(replace(given, link_velocity=1e-3))
    loop.run(0.3)
    loop.tracker.apply(given)
    loop.run(0.1)
    assert loop.tracker.state is State.STOPPED
    loop.tracker.resume()
    return {"stops": 1, "stops: link velocity": 1, "settings changed": 2, "resumes": 1, "recoveries": 1}


def silenced(loop: Loop, given: Settings) -> dict[str, int]:
    """Send no samples for longer than the timeout, under the effort of a stop; return the counters."""
    robot, hold = loop.robot, given.on_stop == "gravity_hold"
    weight = np.linalg.solve(robot.B_m, robot.grad_P_l(loop.states[-1][: robot.n]))
    assert loop.tracker.silence(loop.now + 48 * MS) is None
    loop.run(0.05, answered=False)
    loop.u = loop.tracker.silence(loop.now).copy()
    np.testing.assert_allclose(loop.u, weight if hold else 0.0, rtol=1e-12)
    assert loop.tracker.silence(loop.now + SECOND) is None
    loop.run(0.35 if hold else 0.01, answered=False)
    return {"silences": 1, "recoveries": 1}


@pytest.mark.parametrize("interrupted", [stopped, silenced])
@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
def test_after_an_interruption_the_arm_returns_to_its_motion_without_a_step(
    policy: str, interrupted: Callable[[Loop, Settings], dict[str, int]]
) -> None:
    given = {"state_timeout": 0.05, "on_stop": policy}
    loop = moving_arm(**given)
    loop.run(1.0)
    counters, before = interrupted(loop, settings(2, **given)), len(loop.efforts)
    first = loop.step()
    assert first.state is State.JOINING
    np.testing.assert_allclose(first.u, loop.efforts[before - 1], atol=STEP / 10)
    loop.run_through_transition()
    assert largest_step(loop.efforts[before - 1 :]) < STEP
    jets = TWO_SINES.jets((loop.now - PERIOD - SECOND) * 1e-9)
    np.testing.assert_allclose(loop.commands[-1].jets, jets, rtol=1e-12)
    assert loop.tracker.state is State.TRACKING
    assert loop.error < 2e-3
    assert loop.tracker.counters == counters


def test_a_second_silence_is_detected() -> None:
    tracker = tracker_at(0)
    assert tracker.silence(600 * MS) is not None
    tracker.command(sample(700 * MS, 0.5, 0.5), 700 * MS)
    assert tracker.silence(1100 * MS) is None
    assert tracker.silence(1300 * MS) is not None
    assert tracker_at().silence(10 * SECOND) is None


def test_forward_jump_of_the_stamps_is_a_recovery() -> None:
    tracker = tracker_at(0, MS)
    last = tracker.command(sample(2 * MS, 0.5, 0.5), 2 * MS)
    assert tracker.command(sample(5 * SECOND - MS, 0.4, 0.5), 3 * MS) is None
    command = tracker.command(sample(5 * SECOND, 0.4, 0.5), 4 * MS)
    assert command.state is State.JOINING
    np.testing.assert_allclose(command.u, last.u, atol=1e-12)
    np.testing.assert_allclose(command.jets[:2, 0], [0.4, 0.0], atol=1e-12)
    assert tracker.counters == {"jumps doubted": 1, "forward jumps": 1, "recoveries": 1}


@pytest.mark.parametrize("ahead", [0, MS])
def test_in_simulated_time_a_silence_ends_with_a_recovery(ahead: int) -> None:
    tracker = ControlStep(LAW, SINE, settings(), simulated=True)
    tracker.command(sample(SECOND, 0.5, 0.5), 0)
    stop = tracker.silence(2 * SECOND)
    command = tracker.command(sample(SECOND + ahead, 0.5, 0.5), MS)
    np.testing.assert_allclose(command.u, stop, atol=1e-12)
    assert command.state is State.JOINING
    assert tracker.counters == {"silences": 1, "recoveries": 1}


def test_a_recovery_does_not_begin_outside_the_limits() -> None:
    tracker = tracker_at(0, link_position_upper=1.0)
    command = tracker.command(sample(SECOND, 1.1, 1.1), SECOND)
    assert "stopped: link position of joint1" in tracker.reason
    np.testing.assert_allclose(command.jets, SINE.jets(1.0), rtol=1e-12)
    assert "recoveries" not in tracker.counters


def test_tracking_continues_at_once_without_a_join_time() -> None:
    tracker = tracker_at(0, recovery_join_time=0.0)
    command = tracker.command(sample(SECOND, 0.4, 0.5), SECOND)
    np.testing.assert_array_equal(command.jets, SINE.jets(1.0))
    assert command.state is State.TRACKING
    assert [*tracker.events][-1].sentence == "recovery: tracking at once; a gap of 1 s without states had ended"


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
def test_a_stop_stays_under_its_policy_and_resumes_with_the_last_effort(policy: str) -> None:
    tracker = ControlStep(LAW, Hold([0.0]), settings(link_velocity=0.3, on_stop=policy))
    tracker.command(sample(MS, 0.0, -1e-4, 0.3, 0.1), MS)
    assert tracker.state is State.TRACKING
    for _ in range(2):
        tracker.command(sample(2 * MS, 0.0, 0.0, 0.4, 0.1), 2 * MS)
        assert tracker.state is State.STOPPED
    assert tracker.counters == {"states repeated": 1, "stops": 1, "stops: link velocity": 1}
    for k in range(3, 6):
        command = tracker.command(sample(k * MS, 0.2, 0.2, 0.1, 0.1), k * MS)
        expected = 0.8 * np.sin(0.2) - 0.3 * 0.1 if policy == "gravity_hold" else 0.0
        np.testing.assert_allclose(command.u, expected, rtol=1e-12)
        assert np.isnan(command.V)
    assert tracker.bound_start is None
    assert tracker.seconds["stopped"] == pytest.approx(4e-3, rel=1e-9)
    tracker.resume()
    resumed = tracker.command(sample(6 * MS, 0.2, 0.2, 0.1, 0.1), 6 * MS)
    assert resumed.state is State.JOINING
    np.testing.assert_allclose(resumed.u, command.u, atol=1e-12)


@pytest.mark.parametrize("requested", ["resume", "hold", "follow"])
def test_a_request_waits_for_a_state_with_a_finite_effort(requested: str) -> None:
    trackers = [tracker_at(0, 100 * MS) for _ in range(2)]
    tracker, twin = trackers
    for t in trackers:
        if requested == "resume":
            t.apply(settings(link_velocity=0.1))
            t.command(sample(101 * MS, 0.5, 0.5, 0.2), 101 * MS)
            t.apply(settings())
        if requested == "follow":
            t.follow(Hold([0.2]))
        else:
            getattr(t, requested)()
        t.events.clear()
    before, counters = (tracker.state, tracker.reason), dict(tracker.counters)
    wild = tracker.command(sample(102 * MS, np.nan, 0.5), 102 * MS)
    assert not wild.u.any()
    assert (tracker.state, tracker.reason) == before
    assert tracker.counters == {**counters, "efforts not finite": 1}
    assert kinds(tracker) == ["efforts not finite"]
    for k in (103, 300):
        commands = [t.command(sample(k * MS, 0.5, 0.5), k * MS) for t in trackers]
        np.testing.assert_array_equal(commands[0].jets, commands[1].jets)
        assert not tracker.reason


def test_a_recovery_waits_for_a_state_with_a_finite_effort() -> None:
    tracker = tracker_at(0)
    tracker.command(sample(SECOND, 1e153, 0.5), SECOND)
    assert tracker.state is State.TRACKING
    command = tracker.command(sample(SECOND + MS, 0.5, 0.5), SECOND + MS)
    np.testing.assert_allclose(command.jets[:2, 0], [0.5, 0.0], atol=1e-12)
    assert tracker.counters == {"efforts not finite": 1, "recoveries": 1}


@pytest.mark.parametrize("name", ["link_position_upper", "motor_position_lower", "motor_velocity", "deflection"])
def test_a_stop_is_not_resumed_outside_the_limits(name: str) -> None:
    kind, state = LIMITED[name]
    limit = -0.3 if name.endswith("lower") else 0.3
    tracker = ControlStep(LAW, Hold([0.0]), settings(**{name: limit}))
    for k in range(2):
        tracker.command(sample(k * MS, *state(0.4)), k * MS)
        tracker.resume()
    command = tracker.command(sample(2 * MS, *state(0.5)), 2 * MS)
    assert f"{kind} of joint1" in tracker.reason
    assert "0.5" in tracker.reason
    np.testing.assert_array_equal(command.jets, standing([0.0]))
    assert tracker.counters == {"stops": 3, f"stops: {kind}": 3}
    tracker.command(sample(3 * MS, *state(0.2)), 3 * MS)
    assert tracker.state is State.STOPPED
    tracker.resume()
    tracker.command(sample(4 * MS, *state(0.2)), 4 * MS)
    assert tracker.state is State.JOINING


def test_a_stop_is_counted_once_although_samples_pause_outside_the_limits_and_resume_without_one_does_nothing() -> None:
    tracker = tracker_at(0, link_position_upper=1.0)
    tracker.resume()
    command = tracker.command(sample(MS, 0.5, 0.5), MS)
    assert command.state is State.TRACKING
    assert not tracker.counters
    for stamp in (2 * MS, SECOND, SECOND + MS):
        tracker.command(sample(stamp, 4.5, 4.5), stamp)
    assert tracker.counters["stops"] == 1


def test_gravity_hold_keeps_an_arm_at_rest() -> None:
    q = np.array([1.2, -0.6])
    zeta = np.linalg.solve(TWO.robot.K, TWO.robot.grad_P_l(q))
    far = settings(2, start_error=0.01, on_stop="gravity_hold")
    loop = Loop(TWO, Hold([0.3, 0.3]), far, TWO.robot.state(q, q + zeta, [0.0, 0.0], [0.0, 0.0]))
    loop.run(3.0)
    assert loop.tracker.state is State.STOPPED
    assert np.max(np.abs(loop.x[:2] - q)) < 1e-6


def test_gravity_hold_brings_a_moving_arm_to_a_standstill() -> None:
    loop = moving_arm(on_stop="gravity_hold")
    loop.run(1.0)
    loop.tracker.apply(settings(2, on_stop="gravity_hold", link_velocity=0.0))
    loop.run(4.0)
    assert np.max(np.abs(loop.x[:2] - loop.states[1000][:2])) < 1.0
    resting = loop.x[:2]
    assert np.max(np.abs(np.concatenate(TWO.robot.velocities(loop.x)))) < 0.02
    loop.run(0.5)
    assert np.max(np.abs(loop.x[:2] - resting)) < 0.01


def test_the_last_effort_is_within_the_limits() -> None:
    tracker = ControlStep(LAW, SINE, settings(effort=0.1, on_stop="gravity_hold"))
    assert not tracker.stop_effort().any()
    tracker.command(sample(0, 0.5, 0.5), 0)
    np.testing.assert_array_equal(tracker.stop_effort(), [0.1])
