# SPDX-License-Identifier: Apache-2.0
"""Tracking with a velocity observer: resets, settling, and limits while it settles."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.extensions.python_code import PythonFunction
from fjr_core.motions.point_to_point import Hold
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from tracking.tracked import (
    LAW,
    LIMITED,
    MS,
    OBSERVED,
    SECOND,
    SINE,
    TWO,
    Loop,
    bare_sample,
    largest_step,
    last_effort,
    sample,
    settings,
    tracker_at,
)


class Recorder(PythonFunction):
    """An observer of known velocities that keeps the times and efforts it was given.

    updates: (dt [s], u [N m]) of each sample that continues the estimate; the first after a reset does not.
    """

    bandwidth = 150.0

    def __init__(self) -> None:
        self.velocity, self.updates = [0.1, 0.2], []
        inputs = {"x_hat": (4,), "y": (2,), "u": (1,), "dt": (1,), "gain": (2,)}
        super().__init__("recorder", self._estimate, inputs, {"x_next": (4,)})

    @property
    def function(self) -> ca.Function:
        return self

    def _estimate(self, _x_hat: Any, y: Any, u: Any, dt: Any, _gain: Any) -> Any:
        self.updates.append((dt.item(), u.item()))
        return [np.concatenate([y, self.velocity])]


def settled(**given: Any) -> tuple[ControlStep, Recorder]:
    """Return a tracker whose observer has settled at rest beside its reference, and the observer."""
    recorder = Recorder()
    tracker = ControlStep(LAW, Hold([0.5]), settings(**given), recorder)
    for k in range(OBSERVED + 1):
        tracker.command(bare_sample(k * MS), k * MS)
    return tracker, recorder


def is_reset(tracker: ControlStep) -> bool:
    """Return whether the last sample was the first of the observer."""
    return tracker.controller.measured.k == 0


def test_observer_receives_the_sent_effort() -> None:
    recorder = Recorder()
    tracker = ControlStep(LAW, SINE, settings(effort=1.0), recorder)
    sent = [0.0]
    for k in range(OBSERVED + 3):
        command = tracker.command(bare_sample(k * MS), k * MS)
        np.testing.assert_array_equal(command.velocity, [0.1, 0.2] if k else [0.0, 0.0])
        sent.append(float(command.u[0]))
    assert recorder.updates == [(1e-3, sent[k]) for k in range(1, OBSERVED + 3)]
    assert sent[-1]
    tracker.command(bare_sample((OBSERVED + 2) * MS), OBSERVED * MS)
    assert len(recorder.updates) == OBSERVED + 2
    tracker.apply(settings(effort=0.01))
    tracker.command(bare_sample((OBSERVED + 3) * MS), (OBSERVED + 3) * MS)
    assert recorder.updates[-1][1] == sent[-1], "expected the effort that acted, not its value within the new limit"


def test_an_observer_is_reset_after_a_gap_and_settles_before_its_velocities_are_used() -> None:
    tracker = ControlStep(LAW, SINE, settings(), Recorder())
    for k in range(OBSERVED + 2):
        tracker.command(sample(k * MS, 0.5, 0.5), k * MS)
        assert is_reset(tracker) == (k == 0)
    stop = tracker.silence(SECOND)
    for k in range(OBSERVED):
        stamp = 2 * SECOND + k * MS
        command = tracker.command(sample(stamp, 0.5, 0.5), stamp)
        np.testing.assert_array_equal(command.u, stop)
        assert np.isnan(command.V)
        assert is_reset(tracker) == (k == 0)
    stamp = 2 * SECOND + OBSERVED * MS
    command = tracker.command(sample(stamp, 0.5, 0.5), stamp)
    assert np.isfinite(command.V)
    np.testing.assert_allclose(command.jets[:2], [[0.5], [0.1]], rtol=1e-9)


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
def test_with_an_observer_a_start_sends_the_stop_effort_until_velocities_settle(policy: str) -> None:
    tracker = ControlStep(LAW, SINE, settings(on_stop=policy, start_join_time=0.5), Recorder())
    for beginning in (SECOND, 0):  # the second is a jump back
        tracker.command(bare_sample(beginning), 2 * SECOND)  # a jump is unconfirmed at first
        for k in range(1, OBSERVED + 1):
            command = tracker.command(bare_sample(beginning + k * MS), 2 * SECOND)
            if k < OBSERVED:
                np.testing.assert_allclose(command.u, LAW.robot.grad_P_l([0.5]) if policy != "zero" else 0.0)
                assert command.state is State.JOINING
                assert np.isnan(command.V)
        if beginning == 0:
            command = tracker.command(bare_sample((OBSERVED + 1) * MS), 2 * SECOND)
        assert np.isfinite(command.V)
        np.testing.assert_allclose(command.jets[:2], [[0.5], [0.1]], rtol=1e-9)


@pytest.mark.parametrize("name", ["link_position_upper", "motor_position_upper", "deflection"])
def test_limits_of_positions_are_checked_while_velocities_settle(name: str) -> None:
    tracker, _ = settled(**{name: 0.6})
    for k, q in enumerate((0.5, 0.7)):  # after a silence
        bare = bare_sample(SECOND + k * MS, q)
        bare.q_m = bare.q_m * (-1 if name == "deflection" else 1)
        tracker.command(bare, SECOND + k * MS)
    assert LIMITED[name][0] in tracker.reason


def test_limits_of_velocities_and_tracking_error_are_not_checked_while_velocities_settle() -> None:
    """After a silence the reference starts at the present position of the arm."""
    tracker, recorder = settled(link_velocity=1.0, tracking_error=0.1)
    recorder.velocity[0] = 2.0  # possible difference quotient of encoder steps
    for k in range(OBSERVED + 1):
        recorder.velocity[0] *= k < OBSERVED - 1
        tracker.command(bare_sample(SECOND + k * MS, 0.9), SECOND + k * MS)
        assert not tracker.reason
    assert tracker.counters["recoveries"] == 1
    recorder.velocity[0] = 2.0
    stamp = SECOND + (OBSERVED + 1) * MS
    tracker.command(bare_sample(stamp, 0.9), stamp)
    assert "link velocity" in tracker.reason


def test_an_arm_at_rest_far_from_zero_is_within_the_limits_of_its_velocities() -> None:
    tracker, _ = settled(link_velocity=2.0, motor_velocity=2.0)
    assert tracker.state is State.TRACKING


@pytest.mark.parametrize("side", ["link", "motor"])
@pytest.mark.parametrize("joint", [0, 1])
def test_the_velocity_limit_of_each_joint_waits_until_velocities_settle(joint: int, side: str) -> None:
    """The positions of the joint move at twice its limit."""
    limit, q = np.full(2, np.inf), {"link": np.zeros(2), "motor": np.zeros(2)}
    limit[joint] = 1.0
    observer = fjr.VelocityObserver(TWO.robot, 150.0)
    tracker = ControlStep(TWO, Hold([0.0, 0.0]), settings(2, **{f"{side}_velocity": limit}), observer)
    for k in range(OBSERVED + 1):
        assert not tracker.reason
        state = sample(k * MS, q["link"], q["motor"])
        state.dq_l = state.dq_m = None
        tracker.command(state, k * MS)
        q[side][joint] += 2e-3
    assert tracker.reason.startswith(f"stopped: {side} velocity of joint{joint + 1}: ")


@pytest.mark.parametrize("joint", [0, 1])
def test_a_position_that_overflows_the_estimate_of_one_motor_resets_the_observer(joint: int) -> None:
    tracker = ControlStep(TWO, Hold([0.0, 0.0]), settings(2), fjr.VelocityObserver(TWO.robot, 150.0))
    for k in range(OBSERVED + 2):
        state = sample(k * MS, np.zeros(2), np.zeros(2))
        state.dq_l = state.dq_m = None
        state.q_m[joint] = 1e300 if k == OBSERVED + 1 else 0.0
        tracker.command(state, k * MS)
    assert is_reset(tracker)
    assert tracker.counters == {"observer restarts": 1}


BREAKS = {
    "a gap": lambda loop: loop.run(0.2, answered=False),
    "a state that is not finite": lambda loop: loop.tracker.command(bare_sample(loop.now - MS // 2, np.nan), loop.now),
    "a silence": lambda loop: loop.run(0.6, answered=False),
}


@pytest.mark.parametrize("stop", BREAKS)
def test_with_an_observer_the_effort_has_no_step_after_a_reset(stop: str) -> None:
    loop = Loop(
        LAW, SINE, settings(), LAW.robot.state(0.0, 0.0, 1.0, 1.0), observer=fjr.VelocityObserver(LAW.robot, 150.0)
    )
    loop.run(1.0)
    BREAKS[stop](loop)
    loop.u = last_effort(loop.tracker)
    before = len(loop.efforts)
    loop.run(2.0)
    assert largest_step(loop.efforts[before:]) < 0.2
    assert loop.tracker.counters["recoveries"] == 1
    assert loop.tracker.counters["observer restarts"] == (stop != "a silence")
    assert loop.tracker.state is State.TRACKING
    assert loop.error < 2e-3


def test_sample_without_velocities_requires_an_observer() -> None:
    bare = sample(0, 0.5, 0.5)
    bare.dq_l = None
    with pytest.raises(fjr.StateError, match="no velocities; expected them, or an observer"):
        tracker_at().command(bare, 0)
