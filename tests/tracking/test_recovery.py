# SPDX-License-Identifier: Apache-2.0
"""Recovery after a silence or a jump of the stamps, without a step of the effort."""

from __future__ import annotations

import numpy as np
import pytest

from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from tracking.tracked import (
    ARMS,
    LAW,
    MS,
    PERIOD,
    SECOND,
    SINE,
    Loop,
    largest_step,
    sample,
    settings,
    tracker_at,
)


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("quiet", [0.06, 0.4])
def test_tracking_recovers_from_a_silence_without_a_step(arm: str, policy: str, quiet: float) -> None:
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
    loop.run_through_transition()
    assert largest_step(loop.efforts[before - 1 :]) < step
    t = (loop.now - PERIOD - SECOND) * 1e-9
    np.testing.assert_allclose(loop.commands[-1].jets, reference.jets(t), rtol=1e-12)
    assert loop.tracker.state is State.TRACKING
    assert loop.error < 2e-3
    assert loop.tracker.counters == {"silences": 1, "recoveries": 1}


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
    assert last is not None
    assert command is not None
    assert command.state is State.JOINING
    np.testing.assert_allclose(command.u, last.u, atol=1e-12)
    np.testing.assert_allclose(command.jets[:2, 0], [0.4, 0.0], atol=1e-12)
    assert tracker.counters == {"jumps doubted": 1, "forward jumps": 1, "recoveries": 1}


@pytest.mark.parametrize("ahead", [0, MS])
def test_in_simulated_time_a_silence_ends_with_a_recovery(ahead: int) -> None:
    tracker = ControlStep(LAW, SINE, settings(), simulated=True)
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


def test_tracking_continues_at_once_without_a_join_time() -> None:
    tracker = tracker_at(0, recovery_join_time=0.0)
    command = tracker.command(sample(SECOND, 0.4, 0.5), SECOND)
    assert command is not None
    np.testing.assert_array_equal(command.jets, SINE.jets(1.0))
    assert command.state is State.TRACKING
