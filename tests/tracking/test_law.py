# SPDX-License-Identifier: Apache-2.0
"""The law in the control step: its controller state with robust action, and a law in Python."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
import own_code
from fjr_core.robust.law import Robust, RobustLaw
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from tracking.tracked import LAW, MS, PERIOD, SINE, TWO, Loop, last_effort, sample, settings

ROBUST = Robust(residual_gain=60.0, motor_residual_gain=20.0, integral_gain=4.0, delay=1e-3)


def tracker(**given: Any) -> ControlStep:
    return ControlStep(LAW, SINE, settings(**given), robust=ROBUST)


def controller_state(of: ControlStep) -> np.ndarray:
    """Return the controller state with which the law is evaluated."""
    return law_state(of, "memory")


def law_state(of: ControlStep, name: str) -> np.ndarray:
    """Return a field of struct fjr_law_state."""
    return np.array(list(getattr(of.controller.law, name)))


def efforts_at(of: ControlStep, stamps: Any, **more: Any) -> list[float]:
    """Return the efforts for samples of an arbitrary motion."""
    efforts = []
    for stamp in stamps:
        t = stamp * 1e-9
        command = of.command(sample(stamp, 0.5 + 0.1 * np.sin(9 * t), 0.5 + 0.1 * np.sin(9 * t + 0.1), **more), stamp)
        efforts.append(float(command.u[0]))
    return efforts


def test_the_closed_loop_equals_the_simulation() -> None:
    x0, reference = TWO.robot.state([0.2, 0.2], [0.2, 0.2], [0.0, 0.0], [0.0, 0.0]), fjr.Sine([0.5, 0.5], [2.0, 2.0])
    loop = Loop(TWO, reference, settings(2), x0, robust=ROBUST)
    loop.run(0.3)
    run = fjr.simulate(fjr.Plant(TWO.robot), RobustLaw(TWO, ROBUST), reference, x0, 0.2999, PERIOD * 1e-9)
    np.testing.assert_allclose(np.array(loop.efforts), run.u, rtol=1e-6, atol=1e-8)
    plain = fjr.simulate(fjr.Plant(TWO.robot), TWO, reference, x0, 0.2999, PERIOD * 1e-9)
    assert np.max(np.abs(run.u - plain.u)) > 1e-2


def test_a_repeated_or_an_older_sample_does_not_advance_the_controller_state() -> None:
    one, other = tracker(), tracker()
    wanted = efforts_at(one, range(0, 40 * MS, MS))
    found = efforts_at(other, range(0, 20 * MS, MS))
    again = efforts_at(other, [19 * MS, 19 * MS])
    assert again == [found[-1]] * 2
    assert other.command(sample(5 * MS, 0.1, 0.1), 19 * MS) is None
    assert found + efforts_at(other, range(20 * MS, 40 * MS, MS)) == wanted


@pytest.mark.parametrize("stamp", [0, 3_000 * MS, 90_000 * MS], ids=["jump back", "silence", "jump forward"])
def test_a_gap_resets_the_controller_state(stamp: int) -> None:
    of = tracker(recovery_join_time=0.0)
    efforts_at(of, range(1000 * MS, 1040 * MS, MS))
    assert controller_state(of).any()
    for arrival in (3_000 * MS, 3_001 * MS):
        assert of.command(sample(stamp + arrival - 3_000 * MS, 0.5, 0.5), arrival) is not None
        assert not controller_state(of).any() or arrival > 3_000 * MS
        assert of.controller.law.dt == (0.0 if arrival == 3_000 * MS else 1e-3)


def test_changed_gains_keep_the_controller_state() -> None:
    """The estimate of a load is kept, so that the effort has no step."""
    of, gains = tracker(), replace(fjr.PAPER_GAINS, Pi_l=20.001)
    efforts = efforts_at(of, range(0, 400 * MS, MS))
    learnt = law_state(of, "next")
    of.use(LAW.with_gains(gains))
    efforts += efforts_at(of, [400 * MS])
    np.testing.assert_array_equal(controller_state(of), learnt)
    of.use(LAW.with_gains(gains))
    assert efforts_at(of, [400 * MS]) == efforts[-1:]  # a repeated sample uses the same state
    steps = np.abs(np.diff(efforts[-12:]))
    assert steps[-1] < 2 * steps[:-1].max()


@pytest.mark.parametrize("bad", [np.nan, 1e200])
def test_a_non_finite_effort_is_never_sent_and_resets_the_controller_state(bad: float) -> None:
    of = tracker()
    efforts_at(of, range(0, 40 * MS, MS))
    command = of.command(sample(40 * MS, bad, 0.5), 40 * MS)
    assert np.isfinite(command.u).all()
    efforts = efforts_at(of, range(41 * MS, 60 * MS, MS))
    assert np.isfinite(efforts).all()
    assert np.isfinite(controller_state(of)).all()


def test_the_controller_state_advances_by_the_effort_that_was_sent() -> None:
    of = tracker(effort=(0.5,), effort_rate=(100.0,))
    efforts_at(of, range(0, 10 * MS, MS))
    for stamp in range(10 * MS, 15 * MS, MS):
        before = last_effort(of)
        efforts_at(of, [stamp])
        np.testing.assert_array_equal(law_state(of, "sent"), before)
        assert 0.01 < abs(before[0]) <= 0.5
    u = last_effort(of)
    of.apply(settings(effort=(0.01,)))  # a lower limit does not change what was sent
    efforts_at(of, [15 * MS])
    np.testing.assert_array_equal(law_state(of, "sent"), u)


def test_a_stop_resets_the_controller_state() -> None:
    of = tracker(tracking_error=(0.4,))
    efforts_at(of, range(0, 40 * MS, MS))
    of.command(sample(40 * MS, -1.0, -1.0), 40 * MS)
    assert of.reason
    of.resume()
    of.command(sample(41 * MS, 0.5, 0.5), 41 * MS)
    assert of.controller.law.dt == 0


JOINT = LAW.robot


def tracker_of(kind: type, robust: Robust | None = None, **given: object) -> ControlStep:
    return ControlStep(fjr.PythonLaw(kind(JOINT), JOINT), SINE, settings(**given), robust=robust)


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
@pytest.mark.parametrize("robust", [None, Robust(delay=1e-3, hold=1e-3)], ids=["alone", "with a prediction"])
def test_an_exception_stops_the_arm_until_resume(policy: str, robust: Robust | None) -> None:
    tracker = tracker_of(own_code.Fails, robust, on_stop=policy)
    tracker.command(sample(0, 0.2, 0.2), 0)
    stopped = tracker.command(sample(MS, 0.2, 0.8), MS)
    after = tracker.command(sample(2 * MS, 0.2, 0.2), 2 * MS)
    for command in (stopped, after):
        assert command.state is State.STOPPED
        assert math.isnan(command.V)
        holding = JOINT.grad_P_l([0.2]) if policy == "gravity_hold" else np.zeros(1)
        np.testing.assert_allclose(command.u, holding, atol=1e-12)
    (event,) = [event for event in tracker.events if event.kind == "stops"]
    assert event.sentence.startswith("stopped: Fails raises ZeroDivisionError: too far (own_code.py, line ")
    assert (tracker.counters["stops"], tracker.counters["stops: law"]) == (1, 1)
    tracker.resume()
    resumed = tracker.command(sample(3 * MS, 0.2, 0.2), 3 * MS)
    assert resumed.state is State.JOINING


def test_a_result_of_another_shape_stops_the_arm() -> None:
    tracker = tracker_of(own_code.FailsAtSpeed)
    command = tracker.command(sample(0, 0.2, 0.2, 0.0, -1.0), 0)
    assert command.state is State.STOPPED
    assert tracker.reason == "stopped: u of FailsAtSpeed has shape (2,); expected (1,)"


def test_an_effort_that_is_not_finite_is_replaced_by_the_stop_effort() -> None:
    tracker = tracker_of(own_code.NanBeyond)
    sent = [tracker.command(sample(k * MS, 0.2, q_m), k * MS) for k, q_m in enumerate((0.2, 0.8, 0.2))]
    assert [command is not None and bool(np.isfinite(command.u).all()) for command in sent] == [True] * 3
    assert tracker.counters["efforts not finite"] == 1
    assert tracker.state is not State.STOPPED
