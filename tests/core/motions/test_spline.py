# SPDX-License-Identifier: Apache-2.0
"""Splines: C^4, interpolation of all given values, order of convergence for smooth data, bounded overshoot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BPoly, make_interp_spline

import fjr_core as fjr
from core.motions.cases import ACCELERATIONS, BEGIN, GIVEN, POSITIONS, START, TIMES, VELOCITIES, K, N
from fjr_core.motions import piecewise_polynomial as polynomials
from fjr_core.motions.piecewise_polynomial import MONOTONE, TURNING, PiecewisePolynomial, taylor
from fjr_core.motions.spline import STANDSTILL

RNG = np.random.default_rng(5)
given = pytest.mark.parametrize("derivatives", GIVEN.values(), ids=GIVEN)
begin = pytest.mark.parametrize("start", BEGIN.values(), ids=BEGIN)


@given
@begin
def test_given_values_are_interpolated(derivatives: dict[str, Any], start: dict[str, Any]) -> None:
    jets = fjr.Spline(TIMES, POSITIONS, **derivatives, **start).jets(TIMES)
    np.testing.assert_allclose(jets[:, 0], POSITIONS, atol=1e-15)
    for row, name in ((1, "velocities"), (2, "accelerations")):
        if name in derivatives:
            np.testing.assert_allclose(jets[:-1, row], derivatives[name][:-1], rtol=1e-12, atol=1e-13)


@given
def test_a_spline_starts_with_the_active_jets_or_at_rest_and_ends_at_rest(derivatives: dict[str, Any]) -> None:
    reference = fjr.Spline(TIMES, POSITIONS, **derivatives, start=START)
    np.testing.assert_allclose(reference.jets(0.0), START, rtol=1e-15)
    assert reference.end == 5.0
    for t in (5.0, 5.1, 1e6):
        np.testing.assert_array_equal(reference.jets(t), fjr.standing(POSITIONS[-1]))
    without_start = fjr.Spline(TIMES, POSITIONS)
    for t in (-1.0, 0.0, 0.3):
        np.testing.assert_array_equal(without_start.jets(t), fjr.standing(POSITIONS[0]))


def test_an_end_may_move_and_one_point_suffices_with_an_active_reference() -> None:
    velocities = VELOCITIES + 0.5
    moving = fjr.Spline(TIMES, POSITIONS, velocities, ACCELERATIONS, moving_end=True)
    np.testing.assert_allclose(moving.jets(5.0)[:3], [POSITIONS[-1], velocities[-1], ACCELERATIONS[-1]])
    np.testing.assert_array_equal(moving.jets(5.1), fjr.standing(POSITIONS[-1]))
    reference = fjr.Spline([2.0], [[1.0, 2.0]], start=fjr.standing((0.0, 0.0), (0.3, -0.3)))
    oracle = BPoly.from_derivatives([0.0, 2.0], [[0, 0.3, 0, 0, 0], [1, 0, 0, 0, 0]])
    for order in range(5):
        np.testing.assert_allclose(
            reference.jets(np.linspace(0, 2, 21))[:, order, 0], oracle(np.linspace(0, 2, 21), order)
        )


def test_a_motion_far_from_the_first_point_comes_to_a_standstill_first() -> None:
    """A polynomial over 20 s swings out by 300 rad from these jets, of 0.5 rad at 0.6 Hz."""
    jets = fjr.Sine(0.5, 2 * np.pi * 0.6).jets(0.3)
    for derivatives in ({}, {"velocities": [[0.0], [0.0]]}):
        reference = fjr.Spline([20.0, 30.0], [[0.3], [0.4]], **derivatives, start=jets)
        np.testing.assert_allclose(reference.jets(0.0), jets, rtol=1e-12)
        np.testing.assert_allclose(
            reference.jets(STANDSTILL), fjr.standing(jets[0] + jets[1] * STANDSTILL / 2), atol=1e-9
        )
        np.testing.assert_allclose(reference.jets([20.0, 30.0])[:, 0], [[0.3], [0.4]], atol=1e-12)
        bounds = reference.motion_bounds(0.0, 30.0)
        assert -1.0 < bounds.lower[0, 0] < bounds.upper[0, 0] < 1.0


@pytest.mark.parametrize("spread", [0, 4], ids=["even", "uneven"])
def test_positions_alone_give_the_quintic_spline_of_scipy_inside(spread: int) -> None:
    """20,000 knots, with intervals that differ by a factor of up to 10,000; near the ends more is fixed."""
    k, rng = 20_000, np.random.default_rng(1)
    times, q = np.cumsum(0.01 * 10.0 ** rng.uniform(-spread, 0.0, k)), rng.normal(size=k)
    jets, free = np.zeros((k, 5, 1)), np.zeros((k, 5), dtype=bool)
    jets[:, 0, 0], free[1:-1, 1:] = q, True
    spline = make_interp_spline(times, q, 5, bc_type=([(1, 0.0), (2, 0.0)],) * 2)
    quintic = np.stack([spline(times, order) for order in range(5)], axis=1)[:, :, None]
    h = np.minimum(np.diff(times, append=np.inf), np.diff(times, prepend=-np.inf))
    found, expected = (taylor(each, h)[100:-100] for each in (polynomials.minimum_jerk(times, jets, free), quintic))
    assert np.all(np.abs(found - expected) <= 1e-8 * np.abs(expected).max(axis=1, keepdims=True))


def test_segments_are_hermite_polynomials_of_degree_nine() -> None:
    knots = RNG.normal(size=(K, 5, 2))
    pieces, t = PiecewisePolynomial(TIMES, knots), np.linspace(0.3, 5.0, 300)
    for joint in range(2):
        oracle = BPoly.from_derivatives(TIMES, knots[:, :, joint])
        for order in range(5):
            expected = oracle(t, order)
            np.testing.assert_allclose(
                pieces.jets(t)[:, order, joint], expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max()
            )


def test_fourth_derivatives_are_accurate_in_short_segments_far_from_zero() -> None:
    """Times and positions are of order 1000, with 10 ms between points."""
    t0, f = 1000.0, (np.sin, np.cos, lambda t: -np.sin(t), lambda t: -np.cos(t), np.sin)
    times = t0 + 0.01 * np.arange(4)
    pieces = PiecewisePolynomial(times, np.stack([g(times - t0) for g in f], axis=1)[:, :, None])
    t = t0 + np.linspace(0.001, 0.029, 57)
    assert np.abs(pieces.jets(t)[:, 4, 0] - np.sin(t - t0)).max() < 1e-3


def bump(t: np.ndarray) -> np.ndarray:
    """Return a smooth bump with four zero derivatives at 0 and 2."""
    return np.sin(np.pi * t / 2) ** 6 * np.exp(-t / 3)


@pytest.mark.parametrize("uneven", [0.0, 0.15])
def test_smooth_data_are_interpolated_with_order_five(uneven: float) -> None:
    t, errors = np.linspace(0.0, 2.0, 2001), []
    for k in (12, 24, 48):
        share = np.linspace(0.0, 1.0, k + 1)
        times = 2 * (share + uneven * np.sin(2 * np.pi * share) / np.pi)
        errors.append(np.abs(fjr.Spline(times, bump(times)[:, None]).jets(t)[:, 0, 0] - bump(t)).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 4.9), orders
    assert errors[-1] < 1e-6


def squared_jerk(times: np.ndarray, jets: np.ndarray) -> float:
    """Return the integral of the squared jerk of the reference, by Gauss quadrature on half segments."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    edges = np.sort(np.concatenate([times, times[:-1] + np.diff(times) / 2]))
    h = np.diff(edges)[:, None]
    t, w = edges[:-1, None] + h * (nodes + 1) / 2, h * weights / 2
    return float(w.ravel() @ (PiecewisePolynomial(times, jets).jets(t.ravel())[:, 3] ** 2).sum(axis=1))


@pytest.mark.parametrize("ratio", [1.0, 30.0])
@pytest.mark.parametrize("known", [1, 2, 3])
def test_free_derivatives_minimise_the_squared_jerk(known: int, ratio: float) -> None:
    times = np.cumsum([0.0, 1.0, 1.0 / ratio, 1.0, 0.7, 1.2])
    jets, free = np.zeros((6, 5, 2)), np.zeros((6, 5), dtype=bool)
    jets[:, :known] = RNG.normal(size=(6, known, 2))
    free[1:-1, known:] = True
    chosen = polynomials.minimum_jerk(times, jets, free)
    np.testing.assert_array_equal(chosen[~free], jets[~free])
    least = squared_jerk(times, chosen)
    for knot, order in np.argwhere(free):
        step = np.zeros_like(jets)
        step[knot, order] = 1e-2 * (1.0 + np.abs(chosen[knot, order]))
        more, less = squared_jerk(times, chosen + step), squared_jerk(times, chosen - step)
        assert min(more, less) > least
        assert abs(more - less) < 1e-6 * (more + less - 2 * least) + 1e-9 * least


def beyond(times: np.ndarray, q: np.ndarray, **derivatives: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the overshoot of each segment beyond its two points, and the range of the nearest four points."""
    reference = fjr.Spline(times, q[:, None], **derivatives)
    past, around = [], []
    for i in range(len(q) - 1):
        piece = reference.jets(np.linspace(times[i], times[i + 1], 200))[:, 0, 0]
        low, high = sorted(q[i : i + 2])
        past.append(max(piece.max() - high, low - piece.min(), 0.0))
        around.append(np.ptp(q[max(i - 1, 0) : i + 3]))
    return np.array(past), np.array(around)


@pytest.mark.parametrize("seed", range(20))
def test_overshoot_is_small_of_monotone_positions_and_at_most_a_quarter_of_the_local_range_of_any(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.choice([0.02, 0.1, 1.0, 5.0], 8) * rng.uniform(0.5, 1.0, 8))
    past, around = beyond(times, np.cumsum(rng.choice([0.0, 0.001, 0.1, 1.0], 8)))
    assert np.all(past <= MONOTONE * around + 1e-12)
    past, around = beyond(np.cumsum(10.0 ** rng.uniform(-2, 1, 9)), rng.normal(size=9))
    assert np.all(past <= TURNING * around + 1e-12)


def test_neither_a_step_in_sparse_positions_nor_zero_velocities_at_all_points_overshoot() -> None:
    past, _ = beyond(np.arange(6.0), np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]))
    assert past[0] == past[-1] == 0.0
    assert past.max() <= MONOTONE
    past, around = beyond(np.array([0.0, 0.5, 3.0, 3.2]), np.arange(4.0), velocities=np.zeros((4, 1)))
    assert np.all(past <= MONOTONE * around + 1e-12)


def test_smooth_data_are_unchanged_by_the_overshoot_limit() -> None:
    times = np.linspace(0.0, 2.0, 41)
    jets, free = np.zeros((41, 5, 1)), np.zeros((41, 5), dtype=bool)
    jets[:, 0, 0], free[1:-1, 1:] = bump(times), True
    chosen = polynomials.minimum_jerk(times, jets, free)
    inside = slice(3, -3)  # near the ends the bump is flat to rounding and may change
    np.testing.assert_array_equal(polynomials.without_overshoot(times, chosen, free)[inside], chosen[inside])


def test_joints_are_interpolated_independently_and_in_any_unit_of_time() -> None:
    whole = fjr.Spline(TIMES, POSITIONS, VELOCITIES)
    for joint in range(N):
        alone = fjr.Spline(TIMES, POSITIONS[:, [joint]], VELOCITIES[:, [joint]])
        np.testing.assert_allclose(whole.jets(2.2)[:, [joint]], alone.jets(2.2), rtol=1e-9)
    slow, quick = fjr.Spline(3600 * TIMES, POSITIONS), fjr.Spline(TIMES / 1e3, POSITIONS)
    t = np.linspace(0.3, 5.0, 50)
    np.testing.assert_allclose(slow.jets(3600 * t)[:, 0], quick.jets(t / 1e3)[:, 0], atol=1e-9)
