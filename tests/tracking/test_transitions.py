# SPDX-License-Identifier: Apache-2.0
"""Requested references, holds, and the transitions to them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config.controller import controller_parameters
from fjr_core.config.nodes import all_parameters
from fjr_core.motions.inverse_dynamics import inverse_dynamics
from fjr_core.motions.point_to_point import Hold, standing
from fjr_core.motions.spline import Spline
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from fjr_core.runtime.library import constant
from tracking.tracked import (
    LAW,
    MS,
    PERIOD,
    SECOND,
    SINE,
    STEP,
    STILL,
    TWO,
    TWO_SINES,
    largest_step,
    moving_arm,
    sample,
    settings,
    tracker_at,
)

SHARE, MORE, MATCHED = constant("VELOCITY_SHARE"), constant("MORE"), constant("MATCHED")
QUICKEST, ROOM_SHARE, PEAK = constant("QUICKEST"), constant("ROOM_SHARE"), constant("PEAK")


def joined(
    reference: fjr.Reference, q: Any, dq: Any = 0.0, law: Any = LAW, **given: Any
) -> tuple[ControlStep, float, Any]:
    """Return a tracker that starts at q, dq with a transition; its duration [s], and its jets (k, 5, n)."""
    n = law.robot.n
    given = {"start_join_time": 1.0, **given}
    tracker = ControlStep(law, reference, settings(n, **given))
    tracker.command(sample(SECOND, np.full(n, q), np.full(n, q), np.full(n, dq), np.full(n, dq)), SECOND)
    active = tracker.controller.supervisor.reference
    stamps = np.linspace(SECOND, active.transition_end, 2000).astype(np.int64)
    jets = np.array([tracker.jets_at(int(stamp)) for stamp in stamps])
    return tracker, (active.transition_end - SECOND) * 1e-9, jets


@pytest.mark.parametrize("far", [0.01, 0.3, 1.0, 3.0])
@pytest.mark.parametrize(("velocity", "acceleration"), [(2.0, 10.0), (0.5, 10.0), (9.0, 1.0)])
def test_a_transition_is_the_shortest_within_its_limits(far: float, velocity: float, acceleration: float) -> None:
    """Rest to rest by a polynomial of degree 9: 2.4609 far / T and 9.372 far / T^2, of a series of durations."""
    limits = {"link_velocity": velocity, "motor_velocity": 2 * velocity, "acceleration": acceleration}
    _, duration, jets = joined(Hold([0.0]), far, **limits)
    needed = max(1.0, 2.4609 * far / (SHARE * velocity), np.sqrt(9.372 * far / acceleration))
    assert needed * 0.98 <= duration <= needed * constant("GROWTH") or duration == 1.0
    assert np.abs(jets[:, 1]).max() <= SHARE * velocity * 1.02
    assert np.abs(jets[:, 2]).max() <= acceleration * 1.03
    np.testing.assert_allclose(jets[0, :2, 0], [far, 0.0], atol=1e-12)
    np.testing.assert_allclose(jets[-1], Hold([0.0]).jets(0.0), atol=1e-9)


def braking(tracker: ControlStep) -> float:
    """Return how long the arm brakes before its transition [s]; 0 if it does not."""
    brake = tracker.controller.supervisor.reference.brake
    return max(0.0, brake.t1 - brake.t0)


@pytest.mark.parametrize("acceleration", [1.0, 4.0, 10.0, 20.0])
@pytest.mark.parametrize("seed", range(2))
def test_no_transition_leaves_the_position_limits_if_a_constant_deceleration_would_not(
    seed: int, acceleration: float
) -> None:
    """From any state within the limits, next to them as well, that the stated deceleration can stop there."""
    rng = np.random.default_rng(seed)
    limits: dict[str, Any] = {"link_velocity": 3.0, "motor_velocity": 3.3, "acceleration": acceleration}
    limits |= {"link_position_lower": -2.0, "link_position_upper": 2.0}
    braked = 0
    for _ in range(20):
        amplitude, frequency, phase = rng.uniform(0.2, 0.6, 2), rng.uniform(0.5, 3.0, 2), rng.uniform(0.0, 6.0, 2)
        reference = fjr.Sine(amplitude, frequency, rng.uniform(-0.5, 0.5, 2), phase)
        dq = rng.uniform(0.0, 1.0, 2) * rng.choice([1.0, 0.3, 0.01], 2) * min(3.0, np.sqrt(2.0 * acceleration))
        way = np.maximum(dq**2 / (2 * acceleration), dq * QUICKEST / 3)
        room = np.where(rng.random(2) < 0.7, way * (1 + rng.exponential(0.3, 2)), rng.uniform(way, 4.0))
        side = rng.choice([-1.0, 1.0], 2)
        q, dq = side * (2.0 - np.minimum(room, 4.0)), side * dq
        tracker, _, jets = joined(reference, q, dq, TWO, **limits)
        braked += braking(tracker) > 0
        assert np.abs(jets[:, 0]).max() <= 2.0 + 1e-9
        assert np.abs(jets[:, 1]).max() < 3.0
        np.testing.assert_allclose(jets[0, :2], [q, dq], atol=1e-12)
    assert braked > 5


@pytest.mark.parametrize(("speed", "room"), [*((1.5, room) for room in (1.1, 0.3, 0.16, 0.13, 0.1126)), (0.5, 0.2)])
def test_a_brake_decelerates_no_more_than_the_way_to_a_position_limit_asks(speed: float, room: float) -> None:
    """At hold.deceleration, over ROOM_SHARE of the way, or over that of a constant deceleration at the limit."""
    most, usual = 10.0, settings().hold_deceleration
    limits = {"acceleration": most, "link_velocity": 2.0, "link_position_upper": 1.0 + room}
    tracker, _, _ = joined(Hold([-1.5]), 1.0, speed, **limits)
    before = braking(tracker)
    times = np.linspace(0.0, before, 2000)
    jets = np.array([tracker.jets_at(SECOND + round(t * 1e9)) for t in times])[:, :, 0]
    way = min(PEAK * speed**2 / (3 * usual), max(ROOM_SHARE * room, speed**2 / (2 * most)))
    assert before == pytest.approx(3 * way / speed)
    np.testing.assert_allclose(jets[0, :3], [1.0, speed, 0.0], atol=1e-12)
    np.testing.assert_allclose(jets[-1], [1.0 + way, 0, 0, 0, 0], atol=1e-3)
    assert way <= room
    assert (np.diff(jets[:, 1]) < 1e-9).all()
    assert np.abs(jets[:, 2]).max() == pytest.approx(PEAK * speed**2 / (3 * way), rel=1e-4)
    for order in range(4):
        slope = np.gradient(jets[:, order], times)[1:-1]
        np.testing.assert_allclose(slope, jets[1:-1, order + 1], atol=2e-3 * np.abs(jets[:, order + 1]).max())


@pytest.mark.parametrize(("side", "end"), [(1.0, "upper"), (-1.0, "lower")])
def test_a_position_limit_of_a_motor_bounds_a_transition_as_one_of_its_link(side: float, end: str) -> None:
    """Also at the second joint; a mirrored start has the mirrored transition."""
    q, dq, limit = side * np.array([0.0, 1.0]), side * np.array([0.0, 1.5]), side * np.array([5.0, 1.4])
    given = {"acceleration": 10.0, "link_velocity": 2.0}
    free, link, motor, mirrored = (
        np.append(jets.ravel(), [duration, braking(tracker)])
        for tracker, duration, jets in (
            joined(Hold([0.0, -1.5 * side]), q, dq, TWO, **given),
            joined(Hold([0.0, -1.5 * side]), q, dq, TWO, **given, **{f"link_position_{end}": limit}),
            joined(Hold([0.0, -1.5 * side]), q, dq, TWO, **given, **{f"motor_position_{end}": limit}),
            joined(Hold([0.0, -1.5]), side * q, side * dq, TWO, **given, link_position_upper=side * limit),
        )
    )
    np.testing.assert_array_equal(link, motor)
    np.testing.assert_allclose(np.abs(link), np.abs(mirrored), rtol=1e-9, atol=1e-9)
    assert not np.allclose(free, link)


def test_a_transition_that_respects_the_limits_begins_without_a_brake() -> None:
    """A position limit that the transition does not reach changes no bit of it."""
    given = {"acceleration": 10.0, "link_velocity": 2.0}
    free, near = (joined(SINE, 0.5, 0.8, **given, link_position_upper=upper) for upper in (np.inf, 2.0))
    np.testing.assert_array_equal(free[2], near[2])
    assert not braking(near[0])
    assert near[2][:, 0].max() < 2.0


def test_a_reference_is_followed_after_the_brake_and_can_be_replaced_in_it() -> None:
    limits = {"acceleration": 10.0, "link_velocity": 2.0, "link_position_upper": 1.16}
    tracker, duration, jets = joined(Hold([-1.5]), 1.0, 1.5, **limits)
    assert braking(tracker) > 0
    np.testing.assert_allclose(jets[-1], Hold([-1.5]).jets(0.0), atol=1e-9)
    stamp = SECOND + round(0.1 * 1e9)
    here = tracker.jets_at(stamp)
    tracker.hold()
    command = tracker.command(sample(stamp, here[0], here[0], here[1], here[1]), stamp)
    np.testing.assert_allclose(command.jets, here, rtol=1e-9, atol=1e-9)
    assert not braking(tracker)


def test_without_a_limit_a_transition_accelerates_little_more_than_its_reference() -> None:
    _, duration, jets = joined(TWO_SINES, 0.4, law=TWO)
    own = np.abs(np.asarray(TWO_SINES.jets(np.linspace(0, duration, 1000)))[:, 2]).max(axis=0)
    assert (np.abs(jets[:, 2]).max(axis=0) <= 1.03 * np.maximum(MORE * own, 2.0)).all()


def test_a_transition_is_of_class_c4_and_ends_in_the_reference() -> None:
    tracker, duration, _ = joined(TWO_SINES, 0.7, -0.4, TWO)
    end = SECOND + round(duration * 1e9)
    for stamp in (SECOND + round(0.5 * duration * 1e9), end):
        before, after = (tracker.jets_at(stamp + step) for step in (-1, 1))
        np.testing.assert_allclose(before, after, atol=1e-5)
    np.testing.assert_allclose(tracker.jets_at(end + MS), TWO_SINES.jets(duration + 1e-3), rtol=1e-9, atol=1e-12)
    stamps = SECOND + np.arange(0, round(duration * 1e3), 7) * MS
    for stamp in stamps.tolist():
        slope = (tracker.jets_at(stamp + 10_000)[:-1] - tracker.jets_at(stamp - 10_000)[:-1]) / 2e-5
        if stamp > SECOND:
            np.testing.assert_allclose(slope, tracker.jets_at(stamp)[1:], rtol=1e-3, atol=1e-2)


def largest_effort_of_the_motion() -> float:
    """Return the largest effort that TWO_SINES asks of the two-link arm [N m], by the inverse dynamics."""
    rows = TWO_SINES.jets(np.linspace(0.0, 2 * np.pi, 1000)).swapaxes(0, 1)
    return float(np.abs(inverse_dynamics(TWO.robot).map(1000)(*(row.T for row in rows))[-1].full()).max())


def test_after_a_short_gap_the_arm_follows_its_reference_almost_unchanged() -> None:
    loop = moving_arm()
    loop.run(1.0)
    loop.run(0.12, answered=False)
    before = len(loop.commands)
    loop.run(1.5)
    assert loop.tracker.counters == {"recoveries": 1}
    assert np.abs([command.u for command in loop.commands[before:]]).max() < 1.1 * largest_effort_of_the_motion()
    away = [c.jets[0] - TWO_SINES.jets((1120 + k) * 1e-3)[0] for k, c in enumerate(loop.commands[before:])]
    assert np.abs(away).max() < 0.15


@pytest.mark.parametrize(
    ("q", "dq", "joins"), [(0.05, 0.0, False), (0.05, 0.4, False), (0.05, 0.6, True), (0.2, 0.0, True)]
)
def test_a_start_within_the_start_error_has_no_transition(q: float, dq: float, joins: bool) -> None:
    """The tracking error is that from the transition."""
    tracker = ControlStep(LAW, Hold([0.0]), settings(start_error=0.1, start_join_time=1.0, tracking_error=0.15))
    command = tracker.command(sample(0, q, q, dq, dq), 0)
    assert command.state is (State.JOINING if joins else State.TRACKING)
    assert command.jets[0, 0] == pytest.approx(q if joins else 0.0, abs=1e-12)


def test_a_start_beside_a_moving_arm_needs_little_more_effort_than_the_motion() -> None:
    loop = moving_arm(start_join_time=1.0)
    loop.run(1.0)
    for quiet in (0.1, 0.7):
        loop.u = np.zeros(2)
        loop.run(quiet, answered=False)
        loop.tracker.start()
        before = len(loop.commands)
        loop.run(3.0)
        assert np.abs([command.u for command in loop.commands[before:]]).max() < 1.5 * largest_effort_of_the_motion()
        assert loop.tracker.state is State.TRACKING
        np.testing.assert_allclose(
            loop.commands[-1].jets, TWO_SINES.jets((len(loop.commands) - before - 1) * PERIOD * 1e-9), rtol=1e-9
        )


def test_a_request_that_does_not_match_respects_the_limits() -> None:
    tracker = ControlStep(LAW, SINE, settings(link_velocity=1.5, acceleration=4.0))
    for k in range(3):
        tracker.command(sample(k * MS, 0.0, 0.0, 1.0, 1.0), k * MS)
    tracker.follow(Hold([2.0]))
    tracker.command(sample(3 * MS, 0.0, 0.0, 1.0, 1.0), 3 * MS)
    end = tracker.controller.supervisor.reference.transition_end
    jets = np.array([tracker.jets_at(int(stamp)) for stamp in np.linspace(3 * MS, end, 1000)])
    assert np.abs(jets[:, 1]).max() <= 1.22
    assert np.abs(jets[:, 2]).max() <= 4.1


@pytest.mark.parametrize(
    ("given", "default"),
    [({}, 0.0), ({"robot.model": "planar_two_link"}, 0.0), ({"robot.model": "urdf", "joints": ["a"]}, 1.0)],
)
def test_an_arm_of_a_urdf_starts_by_a_transition_unless_told_otherwise(given: dict[str, Any], default: float) -> None:
    known = all_parameters(controller_parameters, given)
    assert {each.name: each.default for each in known}["start.join_time"] == default


@pytest.mark.parametrize("ahead", [None, 0, 100], ids=["at once", "now", "later"])
def test_a_matched_reference_takes_over_without_a_step(ahead: int | None) -> None:
    loop = moving_arm()
    loop.run(2.0)
    usual = largest_step(loop.efforts[1900:])
    start = loop.now + (ahead or 0) * MS
    jets = loop.tracker.jets_at(start)
    spline = Spline([1.0], [[0.2, 0.2]], start=jets)
    loop.tracker.follow(spline, None if ahead is None else start)
    before = len(loop.efforts)
    loop.run(1.5)
    switch = before + (ahead or 0)
    assert largest_step(loop.efforts[switch - 1 : switch + 1]) < 1.5 * usual
    assert largest_step(loop.efforts[before - 1 :]) < STEP
    np.testing.assert_allclose(loop.commands[switch].jets, jets, rtol=1e-9, atol=1e-9)
    assert loop.commands[switch].state is State.TRACKING
    np.testing.assert_allclose(loop.commands[-1].jets, standing([0.2, 0.2]), atol=1e-12)
    assert loop.error < 2e-3
    assert loop.tracker.bound_start == SECOND


def test_a_reference_that_does_not_match_is_reached_by_a_transition() -> None:
    loop = moving_arm()
    loop.run(2.0)
    sine, start = fjr.Sine([0.3, 0.3], [4.0, 4.0], [-0.2, -0.2]), loop.now
    loop.tracker.follow(sine)
    before = len(loop.efforts)
    command = loop.step()
    np.testing.assert_allclose(command.jets, TWO_SINES.jets(2.0), rtol=1e-9, atol=1e-9)
    assert command.state is State.JOINING
    loop.run_through_transition()
    assert largest_step(loop.efforts[before - 1 :]) < STEP
    np.testing.assert_allclose(loop.tracker.jets_at(loop.now), sine.jets((loop.now - start) * 1e-9))
    assert loop.error < 2e-3


def test_hold_comes_to_a_standstill_without_a_step() -> None:
    loop = moving_arm(hold_deceleration=4.0)
    loop.run(2.0)
    jets = TWO_SINES.jets(2.0)
    time = min(max(float(np.max(np.abs(jets[1]))) / 4.0, 0.2), 2.0)
    loop.tracker.hold()
    before = len(loop.efforts)
    loop.run(time + 1.0)
    assert largest_step(loop.efforts[before - 1 :]) < STEP
    resting = loop.commands[before + int(time * 1e3) + 1].jets
    np.testing.assert_allclose(resting, standing(jets[0] + jets[1] * time / 2), atol=1e-12)
    np.testing.assert_array_equal(loop.commands[-1].jets, resting)
    assert loop.error < 2e-3


def test_a_reference_that_differs_by_a_milliradian_is_reached_by_a_transition() -> None:
    tracker = tracker_at(0, MS, reference=Hold([0.5]))
    tracker.follow(Hold([0.501]))
    command = tracker.command(sample(2 * MS, 0.5, 0.5), 2 * MS)
    assert (command.state, command.jets[0]) == (State.JOINING, pytest.approx([0.5], abs=1e-9))


@pytest.mark.parametrize("q", [0.0, 3.0])
@pytest.mark.parametrize(("share", "state"), [(0.9, State.TRACKING), (1.1, State.JOINING)])
def test_jets_match_up_to_a_share_of_one_and_their_size(q: float, share: float, state: State) -> None:
    tracker = ControlStep(LAW, Hold([q]), settings(**STILL))
    tracker.command(sample(0, q, q), 0)
    tracker.follow(Hold([q + share * MATCHED * (1 + q)]))
    assert tracker.command(sample(MS, q, q), MS).state is state


def test_a_start_from_where_no_transition_is_finite_sends_the_stop_effort() -> None:
    tracker = ControlStep(LAW, Hold([0.0]), settings(start_join_time=1.0, link_velocity=1e-9))
    command = tracker.command(sample(0, 1e302, 1e302), 0)
    np.testing.assert_array_equal(command.u, tracker.stop_effort())
    assert tracker.counters == {"efforts not finite": 1}


def test_hold_while_stopped_holds_the_position_at_resume() -> None:
    tracker = tracker_at(0, link_velocity=1.0)
    tracker.command(sample(MS, 0.5, 0.5, 2.0), MS)
    tracker.hold()
    tracker.command(sample(2 * MS, 0.6, 0.6), 2 * MS)
    tracker.resume()
    for k in (3, 400, 800, 1200, 1500):
        command = tracker.command(sample(k * MS, 0.6, 0.6), k * MS)
        np.testing.assert_allclose(command.jets, standing([0.6]), atol=1e-12)


def test_before_the_first_sample_a_reference_begins_there_and_a_hold_holds_the_present_position() -> None:
    following, holding = (ControlStep(LAW, SINE, settings(start_error=given)) for given in (np.inf, 0.1))
    assert following.jets_at(0) is None
    following.follow(Hold([0.3]))
    holding.hold()
    for tracker, q in ((following, 0.3), (holding, 0.7)):
        command = tracker.command(sample(SECOND, 0.7, 0.7), 0)
        np.testing.assert_array_equal(command.jets, standing([q]))
        assert command.state is State.TRACKING
