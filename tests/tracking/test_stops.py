# SPDX-License-Identifier: Apache-2.0
"""Stops at limits, resumption, and the stop policies."""

from __future__ import annotations

import numpy as np
import pytest

from fjr_core.motions.point_to_point import Hold, standing
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from tracking.tracked import (
    ARMS,
    LAW,
    LIMITED,
    MS,
    SECOND,
    SINE,
    Loop,
    kinds,
    sample,
    settings,
    tracker_at,
)


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
def test_a_stop_stays_under_its_policy_and_resumes_with_the_last_effort(policy: str) -> None:
    tracker = ControlStep(LAW, Hold([0.0]), settings(link_velocity=0.3, on_stop=policy))
    tracker.command(sample(MS, 0.0, 0.0, 0.3), MS)
    assert tracker.state is State.TRACKING
    for _ in range(2):
        tracker.command(sample(2 * MS, 0.0, 0.0, 0.4), 2 * MS)
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


@pytest.mark.parametrize("bad", [float("nan"), 1e153])
@pytest.mark.parametrize("requested", ["resume", "hold", "follow"])
def test_a_request_waits_for_a_state_with_a_finite_effort(requested: str, bad: float) -> None:
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
    wild = tracker.command(sample(102 * MS, bad, 0.5), 102 * MS)
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


@pytest.mark.parametrize("arm", ["paper", "two"])
def test_gravity_hold_keeps_an_arm_at_rest(arm: str) -> None:
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
def test_gravity_hold_brings_a_moving_arm_to_a_standstill(arm: str) -> None:
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
    tracker = ControlStep(LAW, SINE, settings(effort=0.1, on_stop="gravity_hold"))
    assert not tracker.stop_effort().any()
    tracker.command(sample(0, 0.5, 0.5), 0)
    np.testing.assert_array_equal(tracker.stop_effort(), [0.1])
