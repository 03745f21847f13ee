# SPDX-License-Identifier: Apache-2.0
"""Transitions from any jets to any reference are C^4 at both ends and keep the effort of the law continuous."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from core.motions.cases import DURATION, RUNNING, T0, T1, TARGETS
from fjr_core.motions.reference import Reference
from fjr_core.motions.transition import Transition

targets = pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)


def nearly(t: float) -> float:
    """Return the largest float below t."""
    return float(np.nextafter(t, -np.inf))


@targets
def test_transitions_are_exact_at_both_ends_and_have_configurations_of_both_parts(target: Reference) -> None:
    joined = fjr.transition(RUNNING.jets(T0), T0, target, DURATION)
    np.testing.assert_allclose(joined.jets(T0), RUNNING.jets(T0), rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(joined.jets(nearly(T1)), target.jets(T1), rtol=1e-12, atol=1e-10)
    for t in (T1, 2.9, 40.0):
        np.testing.assert_array_equal(joined.jets(t), target.jets(t))
    q = joined.configurations(64)
    assert q.shape == (64, 2)
    np.testing.assert_allclose(q[0], RUNNING.jets(T0)[0])
    np.testing.assert_array_equal(q[16:], target.configurations(48))


def test_repeated_transitions_keep_one_target() -> None:
    joined: Reference = TARGETS["sine"]
    for k in range(5):
        joined = fjr.transition(joined.jets(float(k)), float(k), joined, 1.5)
    assert isinstance(joined, Transition)
    assert joined.target is TARGETS["sine"]


def test_a_transition_that_ends_within_another_follows_the_other_and_ends_with_its_target() -> None:
    first = fjr.transition(RUNNING.jets(0.0), 0.0, TARGETS["hold"], 3.0)
    second = fjr.transition(RUNNING.jets(0.5), 0.5, first, 1.0)
    np.testing.assert_array_equal(second.jets(2.0), first.jets(2.0))
    np.testing.assert_array_equal(second.jets(3.5), TARGETS["hold"].jets(3.5))
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
