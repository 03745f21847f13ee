# SPDX-License-Identifier: Apache-2.0
"""Transitions from any jets to any reference are C^4 at both ends and keep the effort of the law continuous."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.oracle import stencil
from fjr_core.motions.reference import Reference
from fjr_core.motions.transition import Transition

RUNNING = fjr.Sine((0.5, 0.3), (1.0, 2.0), (0.1, -0.2), (0.3, 0.7))
T0, DURATION = 1.3, 0.8
T1 = T0 + DURATION
TIMES = np.array([1.5, 2.0, 3.0, 4.5])
TARGETS: dict[str, Reference] = {
    "sine": fjr.Sine((0.4, -0.2), 1.7, 0.2),
    "hold": fjr.Hold((0.3, -0.4)),
    "circle": fjr.Circle((0.1, 0.2), 0.3, 1.2),
    "spline": fjr.Spline(TIMES, [[0.1, 0.2], [0.3, -0.1], [0.5, 0.4], [0.0, 0.0]]),
    "shifted": fjr.time_shifted(fjr.PointToPoint((0.0, 0.1), (0.4, -0.2), 2.0), 1.6),
    "joined": fjr.transition(fjr.standing((0.1, 0.1)), 1.8, fjr.Hold((0.5, 0.5)), 1.0),
}
targets = pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
LAW = fjr.TrackingLaw(fjr.planar_two_link(), fjr.PAPER_GAINS)
X = LAW.robot.state((0.2, -0.1), (0.25, -0.12), (0.3, 0.1), (0.2, 0.15))


def nearly(t: float) -> float:
    """Return the largest float below t."""
    return float(np.nextafter(t, -np.inf))


@targets
def test_transitions_are_exact_at_both_ends(target: Reference) -> None:
    joined = fjr.transition(RUNNING.jets(T0), T0, target, DURATION)
    np.testing.assert_allclose(joined.jets(T0), RUNNING.jets(T0), rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(joined.jets(nearly(T1)), target.jets(T1), rtol=1e-12, atol=1e-10)
    for t in (T1, 2.9, 40.0):
        np.testing.assert_array_equal(joined.jets(t), target.jets(t))


@targets
def test_in_a_transition_each_row_is_the_derivative_of_the_one_above(target: Reference) -> None:
    joined = fjr.transition(RUNNING.jets(T0), T0, target, DURATION)
    for t in (1.4, 1.6, 1.7, 2.0):
        rates = stencil(lambda s, t=t: joined.jets(t + s), 0.01)
        scale = 1.0 + np.abs(rates[:-1]).max(axis=1, keepdims=True)
        assert np.all(np.abs(joined.jets(t)[1:] - rates[:-1]) < 1e-9 * scale)


@targets
def test_arrays_of_times_give_the_values_of_scalars(target: Reference) -> None:
    joined = fjr.transition(RUNNING.jets(T0), T0, target, DURATION)
    t = np.array([0.0, T0, 1.5, nearly(T1), T1, 3.0])
    np.testing.assert_allclose(joined.jets(t), [joined.jets(s) for s in t], rtol=1e-12, atol=1e-12)


@targets
def test_the_effort_is_continuous_when_the_reference_is_replaced(target: Reference) -> None:
    joined = fjr.transition(RUNNING.jets(T0), T0, target, DURATION)
    for old, new, t in ((RUNNING, joined, T0), (joined, target, T1)):
        before = LAW.command(X, old.jets(nearly(t)))
        np.testing.assert_allclose(LAW.command(X, new.jets(t)), before, rtol=1e-9, atol=1e-9)


def test_without_a_transition_the_effort_jumps() -> None:
    """This jump is what the tests above would detect."""
    u = [LAW.command(X, reference.jets(T0)) for reference in (RUNNING, TARGETS["circle"])]
    assert np.abs(u[0] - u[1]).max() > 1.0


@pytest.mark.parametrize("velocities", [None, np.zeros((4, 2))], ids=["positions", "velocities"])
def test_the_effort_is_continuous_when_a_trajectory_replaces_a_moving_reference(velocities: np.ndarray | None) -> None:
    points = [[0.1, 0.2], [0.3, -0.1], [0.5, 0.4], [0.0, 0.0]]
    trajectory = fjr.time_shifted(fjr.Spline(TIMES, points, velocities, start=RUNNING.jets(T0)), T0)
    before = LAW.command(X, RUNNING.jets(nearly(T0)))
    np.testing.assert_allclose(LAW.command(X, trajectory.jets(T0)), before, rtol=1e-9, atol=1e-9)
    for t in T0 + TIMES:
        before, after = (LAW.command(X, trajectory.jets(s)) for s in (nearly(t), t))
        np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-9)


def test_repeated_transitions_keep_one_target() -> None:
    joined: Reference = TARGETS["sine"]
    for k in range(5):
        joined = fjr.transition(joined.jets(float(k)), float(k), joined, 1.5)
    assert isinstance(joined, Transition)
    assert joined.target is TARGETS["sine"]


def test_a_transition_that_ends_within_another_follows_the_other() -> None:
    first = fjr.transition(RUNNING.jets(0.0), 0.0, TARGETS["hold"], 3.0)
    second = fjr.transition(RUNNING.jets(0.5), 0.5, first, 1.0)
    np.testing.assert_array_equal(second.jets(2.0), first.jets(2.0))
    np.testing.assert_array_equal(second.jets(3.5), TARGETS["hold"].jets(3.5))


def test_a_transition_ends_with_its_target() -> None:
    jets = RUNNING.jets(1.0)
    assert fjr.transition(jets, 1.0, fjr.Hold((0.0, 0.0)), 0.5).end == 1.5
    assert fjr.transition(jets, 1.0, TARGETS["spline"], 0.5).end == 4.5
    assert fjr.transition(jets, 1.0, RUNNING, 0.5).end == np.inf


def test_a_time_shifted_reference_is_the_reference_at_shifted_times() -> None:
    later = fjr.time_shifted(fjr.time_shifted(TARGETS["spline"], 2.0), -0.5)
    np.testing.assert_array_equal(later.jets(3.7), TARGETS["spline"].jets(2.2))
    t = np.array([3.7, 4.0])
    np.testing.assert_array_equal(later.jets(t), TARGETS["spline"].jets(t - 1.5))
    assert later.end == 6.0
    assert fjr.time_shifted(RUNNING, 0.0) is RUNNING
    np.testing.assert_array_equal(later.configurations(9), TARGETS["spline"].configurations(9))


@targets
def test_configurations_are_those_of_the_transition_and_of_the_target(target: Reference) -> None:
    joined = fjr.transition(RUNNING.jets(T0), T0, target, DURATION)
    q = joined.configurations(64)
    assert q.shape == (64, 2)
    np.testing.assert_allclose(q[0], RUNNING.jets(T0)[0])
    np.testing.assert_array_equal(q[16:], target.configurations(48))


def test_constant_jets_have_zero_higher_derivatives() -> None:
    np.testing.assert_array_equal(fjr.standing((1.0, 2.0), (3.0, 4.0)), [[1, 2], [3, 4], [0, 0], [0, 0], [0, 0]])
    np.testing.assert_array_equal(fjr.standing((1.0, 2.0))[1:], np.zeros((4, 2)))
