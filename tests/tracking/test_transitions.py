# SPDX-License-Identifier: Apache-2.0
"""Transitions to the reference take as long as their limits of velocity, acceleration and position ask."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config import builders
from fjr_core.motions.point_to_point import Hold
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from fjr_core.runtime.library import constant
from tracking.tracked import (
    ARMS,
    LAW,
    MS,
    PERIOD,
    SECOND,
    SINE,
    TWO,
    TWO_SINES,
    Loop,
    sample,
    settings,
)

SHARE, MORE = constant("VELOCITY_SHARE"), constant("MORE")


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


@pytest.mark.parametrize("seed", range(5))
def test_no_transition_of_a_moving_arm_exceeds_its_limits(seed: int) -> None:
    """From any state well within the limits to a reference well within them."""
    rng = np.random.default_rng(seed)
    limits = {"link_velocity": 3.0, "motor_velocity": 3.5, "link_position_lower": -2.5, "link_position_upper": 2.5}
    reference = fjr.Sine(rng.uniform(0.2, 0.6, 2), rng.uniform(0.5, 3.0, 2), rng.uniform(-0.5, 0.5, 2))
    for _ in range(10):
        q, dq = rng.uniform(-1.2, 1.2), rng.uniform(-0.8, 0.8)
        _, duration, jets = joined(reference, q, dq, TWO, **limits)
        assert 1.0 <= duration <= 20.0
        assert np.abs(jets[:, 1]).max() < 3.0
        assert np.abs(jets[:, 0]).max() < 2.5


def test_without_a_limit_a_transition_accelerates_little_more_than_its_reference() -> None:
    _, duration, jets = joined(TWO_SINES, 0.4, law=TWO)
    own = np.abs(np.asarray(TWO_SINES.jets(np.linspace(0, duration, 1000)))[:, 2]).max(axis=0)
    assert (np.abs(jets[:, 2]).max(axis=0) <= 1.03 * np.maximum(MORE * own, 2.0)).all()


@pytest.mark.parametrize("arm", ARMS)
def test_a_transition_is_of_class_c4_and_ends_in_the_reference(arm: str) -> None:
    law, reference, _, _ = ARMS[arm]
    tracker, duration, _ = joined(reference, 0.7, -0.4, law)
    end = SECOND + round(duration * 1e9)
    for stamp in (SECOND + round(0.5 * duration * 1e9), end):
        before, after = (tracker.jets_at(stamp + step) for step in (-1, 1))
        np.testing.assert_allclose(before, after, atol=1e-5)
    np.testing.assert_allclose(tracker.jets_at(end + MS), reference.jets(duration + 1e-3), rtol=1e-9, atol=1e-12)
    stamps = SECOND + np.arange(0, round(duration * 1e3), 7) * MS
    for stamp in stamps.tolist():
        slope = (tracker.jets_at(stamp + 10_000)[:-1] - tracker.jets_at(stamp - 10_000)[:-1]) / 2e-5  # type: ignore[index]
        if stamp > SECOND:
            np.testing.assert_allclose(slope, tracker.jets_at(stamp)[1:], rtol=1e-3, atol=1e-2)  # type: ignore[index]


def test_after_a_short_gap_the_arm_follows_its_reference_almost_unchanged() -> None:
    law, reference, x0, _ = ARMS["two"]
    loop, undisturbed = (Loop(law, reference, settings(2), x0) for _ in range(2))
    undisturbed.run(4.7)
    largest = np.abs(undisturbed.efforts[1500:]).max()
    loop.run(3.0)
    loop.run(0.12, answered=False)
    before = len(loop.commands)
    loop.run(1.5)
    assert loop.tracker.counters == {"recoveries": 1}
    assert np.abs([command.u for command in loop.commands[before:]]).max() < 1.1 * largest
    away = [c.jets[0] - reference.jets((3120 + k) * 1e-3)[0] for k, c in enumerate(loop.commands[before:])]
    assert np.abs(away).max() < 0.15


@pytest.mark.parametrize(
    ("q", "dq", "joins"), [(0.05, 0.0, False), (0.05, 0.4, False), (0.05, 0.6, True), (0.2, 0.0, True)]
)
def test_a_start_within_the_start_error_has_no_transition(q: float, dq: float, joins: bool) -> None:
    tracker = ControlStep(LAW, Hold([0.0]), settings(start_error=0.1, start_join_time=1.0))
    command = tracker.command(sample(0, q, q, dq, dq), 0)
    assert command is not None
    assert command.state is (State.JOINING if joins else State.TRACKING)
    assert command.jets[0, 0] == pytest.approx(q if joins else 0.0, abs=1e-12)


def test_a_start_beside_a_moving_arm_needs_little_more_effort_than_the_motion() -> None:
    law, reference, x0, _ = ARMS["two"]
    given = settings(2, start_join_time=1.0)
    loop = Loop(law, reference, given, x0)
    loop.run(3.0)
    largest = np.abs(loop.efforts).max()
    for quiet in (0.1, 0.7):
        loop.u = np.zeros(2)
        loop.run(quiet, answered=False)
        loop.tracker.start()
        before = len(loop.commands)
        loop.run(3.0)
        assert np.abs([command.u for command in loop.commands[before:]]).max() < 1.5 * largest
        assert loop.tracker.state is State.TRACKING
        np.testing.assert_allclose(
            loop.commands[-1].jets, reference.jets((len(loop.commands) - before - 1) * PERIOD * 1e-9), rtol=1e-9
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
    known = builders.all_parameters(builders.controller_parameters, given)
    assert {each.name: each.default for each in known}["start.join_time"] == default
