# SPDX-License-Identifier: Apache-2.0
"""Built-in references: C^4 with four exact derivatives; shapes, motion and configurations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import betainc

import fjr_core as fjr
from core.oracles.oracle import stencil
from fjr_core.motions.reference import Reference

SINES = {
    "plain": fjr.Sine(1.0, 1.0),
    "shifted": fjr.Sine(0.7, 2.5, offset=-0.4, phase=1.1),
    "three": fjr.Sine((1.0, 0.5, -0.2), (1.0, 2.0, 3.5), offset=(0.0, 0.1, 0.2), phase=(0.3, 0.0, -2.0)),
    "backwards": fjr.Sine((1.0, -0.5), (-1.0, -2.0), phase=(0.3, 2.0)),
    "still": fjr.Sine(0.0, 1.0, offset=0.3),
}
OTHERS = {
    "two sines": fjr.MultiSine([[1.0, 0.5], [0.3, -0.2]], [[1.0, 2.0], [3.0, 0.0]], [[0.1, 0.2], [0.3, 0.4]], (0.5, 1)),
    "one way": fjr.PointToPoint((0.1, -0.5), (1.0, 0.5), 1.9),
    "to and fro": fjr.PointToPoint((0.1, -0.5), (1.0, 0.5), 1.9, dwell=0.3, returns=True),
    "no dwell": fjr.PointToPoint(0.1 * np.ones(1), 1.0, 1.7, returns=True),
    "circle": fjr.Circle((0.4, -0.2, 1.0), 0.5, -2.0, 0.3, 1.6),
    "hold": fjr.Hold((0.3, -0.2)),
}
references = pytest.mark.parametrize("reference", [*SINES.values(), *OTHERS.values()], ids=[*SINES, *OTHERS])
sines = pytest.mark.parametrize("reference", SINES.values(), ids=SINES)


@references
@pytest.mark.parametrize("t", [0.37, 1.23, 2.6, 12.3])
def test_each_row_is_the_derivative_of_the_one_above(reference: Reference, t: float) -> None:
    rates = stencil(lambda s: reference.jets(t + s), 0.01)
    np.testing.assert_allclose(reference.jets(t)[1:], rates[:-1], rtol=1e-9, atol=1e-9)


@references
@pytest.mark.parametrize("t", [0.0, 1.6, 1.7, 1.9, 2.2, 3.4, 4.1, 4.4, 8.8])
def test_derivatives_are_continuous_at_the_ends_of_a_transition(reference: Reference, t: float) -> None:
    if t == 0.0 and isinstance(reference, (fjr.Sine, fjr.MultiSine)):
        return  # no transition at the start
    before, after = reference.jets(np.nextafter(t, -np.inf)), reference.jets(np.nextafter(t, np.inf))
    np.testing.assert_allclose(before, after, atol=1e-11)


@sines
def test_first_row_is_the_sine(reference: fjr.Sine) -> None:
    a, w, c, p = (np.asarray(getattr(reference, key)) for key in ("amplitude", "frequency", "offset", "phase"))
    assert reference.jets(0.9)[0] == pytest.approx(c + a * np.sin(w * 0.9 + p), abs=1e-15)


@references
def test_shapes(reference: Reference) -> None:
    n = reference.n
    assert reference.jets(0.5).shape == (5, n)
    times = np.array([-0.1, 0.0, 0.5, 1.5, 7.0])
    assert reference.jets(times).shape == (5, 5, n)
    np.testing.assert_allclose(reference.jets(times), [reference.jets(t) for t in times], rtol=1e-12, atol=1e-12)
    assert reference.configurations(17).shape == (17, n)
    assert reference.configurations(1).shape == (1, n)


@references
def test_returned_arrays_are_copies(reference: Reference) -> None:
    for t in (0.5, np.array([0.5, 0.7])):
        first = reference.jets(t)
        kept = first.copy()
        first[...] = np.nan
        np.testing.assert_array_equal(reference.jets(t), kept)


@references
def test_after_its_end_a_reference_is_constant(reference: Reference) -> None:
    if np.isfinite(reference.end):
        last = reference.jets(reference.end)
        np.testing.assert_array_equal(last[1:], 0.0)
        np.testing.assert_array_equal(reference.jets(reference.end + 100.0), last)


@references
def test_configurations_lie_on_the_reference(reference: Reference) -> None:
    e = reference.motion_bounds(0.0, np.inf)
    q = reference.configurations(200)
    assert np.all((q >= e.lower[0] - 1e-12) & (q <= e.upper[0] + 1e-12))
    reach = np.ptp(q, axis=0)
    assert np.all(reach >= 0.9 * (e.upper[0] - e.lower[0]))


def test_scalars_apply_to_every_joint() -> None:
    assert fjr.Sine(1.0, 1.0).n == 1
    mixed, spelled = (
        fjr.Sine((1.0, 0.5), 2.0, offset=0.1),
        fjr.Sine((1.0, 0.5), (2.0, 2.0), offset=(0.1, 0.1)),
    )
    assert mixed.n == 2
    assert np.array_equal(mixed.jets(0.7), spelled.jets(0.7))


def test_paper_reference_starts_at_zero_with_unit_velocity() -> None:
    assert fjr.Sine(1.0, 1.0).jets(0.0)[:, 0] == pytest.approx([0, 1, 0, -1, 0], abs=1e-15)


def test_a_multi_sine_is_the_sum_of_its_sines() -> None:
    a, w, p = np.random.default_rng(1).normal(size=(3, 4, 2))
    whole = fjr.MultiSine(a, w, p, (0.5, -0.5))
    each = [fjr.Sine(*rows) for rows in zip(a, w, (0.0,) * 4, p, strict=True)]
    expected = sum(sine.jets(1.3) for sine in each) + fjr.standing((0.5, -0.5))
    np.testing.assert_allclose(whole.jets(1.3), expected, rtol=1e-13, atol=1e-13)


def test_one_row_of_sines_is_the_sine() -> None:
    one, same = fjr.MultiSine([[1.0, 0.3]], [[2.0, 3.0]], 0.4, 0.1), fjr.Sine((1.0, 0.3), (2.0, 3.0), 0.1, 0.4)
    np.testing.assert_allclose(one.jets(0.7), same.jets(0.7), rtol=1e-14)
    np.testing.assert_array_equal(one.configurations(20), same.configurations(20))


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
