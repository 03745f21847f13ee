# SPDX-License-Identifier: Apache-2.0
"""A law of the user keeps the tracker's safety: nothing that is not finite is sent, and a failure stops the arm."""

from __future__ import annotations

import math

import numpy as np
import pytest

import fjr_core as fjr
import own_code
from fjr_core.law.robust import Robust
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from tracking.tracked import LAW, MS, SINE, Loop, sample, settings

JOINT = LAW.robot


def tracker_of(kind: type, robust: Robust | None = None, **given: object) -> ControlStep:
    return ControlStep(fjr.PythonLaw(kind(JOINT), JOINT), SINE, settings(**given), robust=robust)


def test_the_effort_is_that_of_the_law() -> None:
    law = fjr.PythonLaw(own_code.Pd(JOINT), JOINT)
    loop = Loop(law, SINE, settings(), JOINT.state(0.1, 0.1, 0.0, 0.0))
    for k in range(20):
        position, velocity = loop.x[:2].copy(), np.concatenate(JOINT.velocities(loop.x))
        command = loop.step()
        assert command is not None
        assert (command.u == law.own.effort(position, velocity, SINE.jets(k * 1e-3))).all()
    assert not loop.tracker.events


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
@pytest.mark.parametrize("robust", [None, Robust(delay=1e-3, hold=1e-3)], ids=["alone", "with a prediction"])
def test_an_exception_stops_the_arm_until_resume(policy: str, robust: Robust | None) -> None:
    tracker = tracker_of(own_code.Fails, robust, on_stop=policy)
    first = tracker.command(sample(0, 0.2, 0.2), 0)
    stopped = tracker.command(sample(MS, 0.2, 0.8), MS)
    after = tracker.command(sample(2 * MS, 0.2, 0.2), 2 * MS)
    for command in (stopped, after):
        assert command is not None
        assert command.state is State.STOPPED
        assert math.isnan(command.V)
        holding = JOINT.grad_P_l([0.2]) if policy == "gravity_hold" else np.zeros(1)
        np.testing.assert_allclose(command.u, holding, atol=1e-12)
    (event,) = [event for event in tracker.events if event.kind == "stops"]
    assert event.sentence.startswith("stopped: Fails raises ZeroDivisionError: too far (own_code.py, line ")
    assert (tracker.counters["stops"], tracker.counters["stops: law"]) == (1, 1)
    tracker.resume()
    resumed = tracker.command(sample(3 * MS, 0.2, 0.2), 3 * MS)
    assert resumed is not None
    assert resumed.state is State.JOINING
    assert first is not None


def test_a_result_of_another_shape_stops_the_arm() -> None:
    tracker = tracker_of(own_code.FailsAtSpeed)
    command = tracker.command(sample(0, 0.2, 0.2, 0.0, -1.0), 0)
    assert command is not None
    assert command.state is State.STOPPED
    assert tracker.reason == "stopped: u of FailsAtSpeed has shape (2,); expected (1,)"


def test_an_effort_that_is_not_finite_is_replaced_by_the_stop_effort() -> None:
    tracker = tracker_of(own_code.NanBeyond)
    sent = [tracker.command(sample(k * MS, 0.2, q_m), k * MS) for k, q_m in enumerate((0.2, 0.8, 0.2))]
    assert [command is not None and bool(np.isfinite(command.u).all()) for command in sent] == [True] * 3
    assert tracker.counters["efforts not finite"] == 1
    assert tracker.state is not State.STOPPED


@pytest.mark.parametrize("kind", [own_code.NotFinite, own_code.WrongShape])
def test_a_law_that_fails_at_rest_at_0_is_refused(kind: type) -> None:
    with pytest.raises(fjr.UserCodeError, match=f"u of {kind.__name__} "):
        tracker_of(kind)
