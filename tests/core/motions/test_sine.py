# SPDX-License-Identifier: Apache-2.0
"""Finite Fourier series that start and end at rest, and the bounds of sums of sines."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.motions.sine import RestingSeries, common_period, logarithmic_harmonics

SERIES = RestingSeries(4.0, (1, 2, 3, 5, 8))


@pytest.fixture
def coefficients() -> np.ndarray:
    return np.random.default_rng(1).standard_normal((SERIES.size, 2))


def test_any_free_coefficients_rest_at_the_start_and_at_the_end_of_each_period(coefficients):
    jets = SERIES.reference(coefficients).jets(np.array([0.0, 4.0, 8.0]))
    moving = np.abs(SERIES.reference(coefficients).jets(np.linspace(0, 4, 101))).max(axis=0)
    assert np.all(np.abs(jets[:, 1:]) < 1e-9 * moving[1:])
    assert np.allclose(jets[:, 0], jets[0, 0])


def test_the_basis_gives_the_jets_of_the_reference(coefficients):
    t = np.linspace(0, 5, 23)
    jets = np.einsum("rks,sn->krn", SERIES.jet_basis(t), coefficients)
    assert np.allclose(jets, SERIES.reference(coefficients).jets(t), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("highest", "count"), [(3, 10), (8, 5), (100, 10)])
def test_harmonics_are_distinct_and_reach_the_highest(highest, count):
    found = logarithmic_harmonics(highest, count)
    assert len(found) == min(highest, count) == len(set(found))
    assert (found[0], found[-1]) == (1, highest)


def test_bounds_of_sines_with_a_common_period_are_the_extremes_over_it(coefficients):
    reference = SERIES.reference(coefficients)
    jets = reference.jets(np.linspace(0, 4, 40001))[:, :3]
    bounds = reference.motion_bounds(0.0, np.inf)
    assert np.allclose(bounds.lower, jets.min(axis=0), rtol=1e-6, atol=1e-6)
    assert np.allclose(bounds.upper, jets.max(axis=0), rtol=1e-6, atol=1e-6)


def test_sines_without_a_common_period_are_bounded_by_the_sum_of_their_amplitudes():
    reference = fjr.MultiSine([[1.0], [0.5]], [[1.0], [np.sqrt(2.0)]])
    assert reference.motion_bounds(0.0, np.inf).upper[0, 0] == pytest.approx(1.5)


def test_the_common_period_is_that_of_the_greatest_common_divisor():
    assert common_period(2 * np.pi * np.array([0.6, 1.0, 0.0, 1.4])) == pytest.approx(5.0)
    assert common_period(np.array([1.0, np.pi])) is None
    assert common_period(np.array([0.0])) is None
