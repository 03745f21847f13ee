# SPDX-License-Identifier: Apache-2.0
"""Built-in references: C^4 with four exact derivatives; shapes, motion and configurations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import betainc

import fjr_core as fjr
from core.motions.cases import FREE, KNOTS, OTHERS, REFERENCES, SERIES, SINES, SPLINES, T0, T1, references
from core.oracles.oracle import stencil
from fjr_core.motions.reference import Reference
from fjr_core.motions.sine import common_period
from fjr_core.motions.transition import Transition
from fjr_identification.excitation import logarithmic_harmonics


@references
@pytest.mark.parametrize("t", [0.37, 1.23, 1.54, 2.6, 4.7, 12.3])
def test_each_row_is_the_derivative_of_the_one_above(reference: Reference, t: float) -> None:
    rates = stencil(lambda s: reference.jets(t + s), 0.01)
    np.testing.assert_allclose(reference.jets(t)[1:], rates[:-1], rtol=1e-9, atol=1e-9)


@references
def test_references_are_c4_once_they_have_begun_and_constant_after_their_end(reference: Reference) -> None:
    motion = reference.segment if isinstance(reference, Transition) else getattr(reference, "pieces", None)
    begin = 0.0 if motion is None else motion.times[0]
    scale = 1.0 + np.abs(reference.jets(np.linspace(0.0, 5.0, 501))).max(axis=(0, 2))[:, None]
    for t in KNOTS:
        before, after = reference.jets(np.nextafter(t, -np.inf)), reference.jets(np.nextafter(t, np.inf))
        assert t <= begin or np.all(np.abs(before - after) < np.maximum(1e-12 * scale, 1e-11)), t
    if np.isfinite(reference.end):
        last = reference.jets(reference.end)
        np.testing.assert_array_equal(last[1:], 0.0)
        np.testing.assert_array_equal(reference.jets(reference.end + 100.0), last)


@references
def test_jets_at_many_times_are_those_at_each_and_returned_arrays_are_copies(reference: Reference) -> None:
    times = np.array([-0.1, 0.0, 0.5, T0, 1.5, np.nextafter(T1, 0.0), T1, 7.0])
    alone = [reference.jets(t) for t in times]
    reference.jets(times)[...] = np.nan
    reference.jets(0.5)[...] = np.nan
    np.testing.assert_allclose(reference.jets(times), alone, rtol=1e-12, atol=1e-12)
    assert alone[0].shape == (5, reference.n)
    assert [reference.configurations(k).shape for k in (1, 17)] == [(1, reference.n), (17, reference.n)]


@pytest.mark.parametrize("reference", [*SINES.values(), *OTHERS.values(), *SPLINES.values()])
def test_configurations_lie_on_the_reference(reference: Reference) -> None:
    e = reference.motion_bounds(0.0, np.inf)
    q = reference.configurations(200)
    assert np.all((q >= e.lower[0] - 1e-12) & (q <= e.upper[0] + 1e-12))
    reach = np.ptp(q, axis=0)
    assert np.all(reach >= 0.9 * (e.upper[0] - e.lower[0]))


def test_sines_cover_their_ranges_and_those_of_one_frequency_keep_their_phases() -> None:
    """Sampling the slowest sine at equal intervals would alias its multiples to a constant."""
    assert np.all(np.ptp(fjr.Sine((0.5, 3.0), (0.125, 4.0)).configurations(64), axis=0) > (0.95, 5.7))
    first, second = fjr.Sine((1.0, 0.5), 2.0).configurations(64).T
    np.testing.assert_allclose(second, first / 2)


@pytest.mark.parametrize("name", [*SINES, "one row", "two sines"])
def test_first_row_of_sines_is_their_sum(name: str) -> None:
    reference = REFERENCES[name]
    a, w, c, p = (np.asarray(getattr(reference, key)) for key in ("amplitude", "frequency", "offset", "phase"))
    found = np.atleast_2d(a * np.sin(w * 0.9 + p)).sum(axis=0)
    np.testing.assert_allclose(reference.jets(0.9)[0], c + found, rtol=1e-14, atol=1e-15)


def test_point_to_point_is_the_smoothstep_of_degree_nine() -> None:
    """The only such polynomial is the regularised incomplete beta function I_s(5, 5)."""
    t = np.linspace(0.0, 1.9, 40)
    share = (OTHERS["one way"].jets(t)[:, 0] - (0.1, -0.5)) / (0.9, 1.0)
    np.testing.assert_allclose(share, betainc(5, 5, t / 1.9)[:, None].repeat(2, axis=1), atol=1e-14)
    assert OTHERS["one way"].jets(0.95)[1, 1] == pytest.approx(2.4609375 / 1.9)


def test_a_returning_motion_dwells_and_returns() -> None:
    way = OTHERS["to and fro"]
    for t, q in ((0.0, (0.1, -0.5)), (1.9, (1.0, 0.5)), (2.2, (1.0, 0.5)), (4.1, (0.1, -0.5)), (4.39, (0.1, -0.5))):
        np.testing.assert_allclose(way.jets(t), fjr.standing(q), atol=1e-11)
    np.testing.assert_allclose(way.jets(0.7)[0] - (0.1, -0.5), (1.0, 0.5) - way.jets(2.9)[0], atol=1e-13)
    np.testing.assert_allclose(way.jets(0.7), way.jets(0.7 + 44.0), atol=1e-9)


def test_circle_is_exact_from_rest_to_its_frequency() -> None:
    circle = OTHERS["circle"]
    jets = circle.jets(np.linspace(-0.5, 12.0, 301))
    np.testing.assert_allclose(np.hypot(*(jets[:, 0, :2] - (0.4, -0.2)).T), 0.5, rtol=1e-13)
    np.testing.assert_array_equal(jets[:, :, 2], np.tile([1.0, 0, 0, 0, 0], (301, 1)))
    first = fjr.standing([0.4 + 0.5 * np.cos(0.3), -0.2 + 0.5 * np.sin(0.3), 1.0])
    np.testing.assert_allclose(circle.jets(0.0), first, atol=1e-15)
    np.testing.assert_allclose(np.hypot(*jets[-1, 1, :2]), 0.5 * 2.0)
    np.testing.assert_allclose(circle.jets(9.0), circle.jets(9.0 + np.pi), atol=1e-12)
    (x, y), (dx, dy) = circle.jets(5.0)[:2, :2] - [[0.4, -0.2], [0.0, 0.0]]
    assert x * dy - y * dx == pytest.approx(-2.0 * 0.5**2)  # a negative frequency is clockwise


def test_the_basis_of_a_series_gives_the_jets_of_its_reference_and_its_harmonics_are_distinct() -> None:
    t = np.linspace(0, 5, 23)
    jets = np.einsum("rks,sn->krn", SERIES.jet_basis(t), FREE)
    np.testing.assert_allclose(jets, SERIES.reference(FREE).jets(t), rtol=1e-9, atol=1e-9)
    for highest, count in ((3, 10), (8, 5), (100, 10)):
        found = logarithmic_harmonics(highest, count)
        assert len(found) == min(highest, count) == len(set(found))
        assert (found[0], found[-1]) == (1, highest)


def test_the_common_period_is_that_of_the_greatest_common_divisor() -> None:
    assert common_period(2 * np.pi * np.array([0.6, 1.0, 0.0, 1.4])) == pytest.approx(5.0)
    assert common_period(np.array([1.0, np.pi])) is None
    assert common_period(np.array([0.0])) is None
