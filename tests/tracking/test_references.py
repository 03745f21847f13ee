# SPDX-License-Identifier: Apache-2.0
"""Replacement of the reference, and hold."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.motions.point_to_point import Hold, standing
from fjr_core.motions.spline import Spline
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from tracking.tracked import (
    ARMS,
    LAW,
    MS,
    SECOND,
    SINE,
    Loop,
    largest_step,
    sample,
    settings,
    tracker_at,
)


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
    assert loop.tracker.bound_start == SECOND


@pytest.mark.parametrize("arm", ARMS)
def test_a_reference_that_does_not_match_is_reached_by_a_transition(arm: str) -> None:
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
    loop.run_through_transition()
    assert largest_step(loop.efforts[before - 1 :]) < step
    sine = fjr.Sine(np.full(n, 0.3), np.full(n, 4.0), np.full(n, -0.2))
    np.testing.assert_allclose(loop.tracker.jets_at(loop.now), sine.jets((loop.now - start) * 1e-9))
    assert loop.error < 2e-3


@pytest.mark.parametrize("arm", ARMS)
def test_hold_comes_to_a_standstill_without_a_step(arm: str) -> None:
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


def test_hold_before_the_first_sample_holds_the_present_position() -> None:
    tracker = ControlStep(LAW, SINE, settings(start_error=0.1))
    tracker.hold()
    command = tracker.command(sample(0, 0.7, 0.7), 0)
    assert command is not None
    np.testing.assert_array_equal(command.jets, standing([0.7]))
    assert command.state is State.TRACKING


def test_hold_while_stopped_holds_the_position_at_resume() -> None:
    tracker = tracker_at(0, link_velocity=1.0)
    tracker.command(sample(MS, 0.5, 0.5, 2.0), MS)
    tracker.hold()
    tracker.command(sample(2 * MS, 0.6, 0.6), 2 * MS)
    tracker.resume()
    for k in (3, 400, 800, 1200, 1500):
        command = tracker.command(sample(k * MS, 0.6, 0.6), k * MS)
        np.testing.assert_allclose(command.jets, standing([0.6]), atol=1e-12)  # type: ignore[union-attr]


def test_a_reference_given_before_the_first_sample_begins_there() -> None:
    tracker = ControlStep(LAW, SINE, settings())
    assert tracker.jets_at(0) is None
    tracker.follow(Hold([0.3]))
    command = tracker.command(sample(SECOND, 0.5, 0.5), 0)
    np.testing.assert_array_equal(command.jets, standing([0.3]))  # type: ignore[union-attr]
