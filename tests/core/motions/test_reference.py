# SPDX-License-Identifier: Apache-2.0
"""Built-in references: C^4 with four exact derivatives; shapes, motion, configurations, and what is refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import betainc

import fjr_core as fjr
from core.motions.cases import (
    DURATION,
    FREE,
    KNOTS,
    OTHERS,
    REFERENCES,
    RUNNING,
    SERIES,
    SINES,
    SPLINES,
    T0,
    T1,
    TARGETS,
    references,
)
from core.oracles.oracle import stencil
from fjr_core.motions.piecewise_polynomial import PolynomialReference
from fjr_core.motions.reference import Reference
from fjr_core.motions.sine import common_period
from fjr_core.motions.transition import Transition
from fjr_identification.excitation.optimal_design import RestingSeries, logarithmic_harmonics
from fuzzing import refused


@references
@pytest.mark.parametrize("t", [0.37, 1.23, 1.54, 2.6, 4.7, 12.3])
def test_each_row_is_the_derivative_of_the_one_above(reference: Reference, t: float) -> None:
    rates = stencil(lambda s: reference.jets(t + s), 0.01)
    np.testing.assert_allclose(reference.jets(t)[1:], rates[:-1], rtol=1e-9, atol=1e-9)


@references
def test_references_are_c4_once_they_have_begun_and_constant_after_their_end(reference: Reference) -> None:
    motion = reference.segment if isinstance(reference, Transition) else reference
    begin = motion.knot_times[0] if isinstance(motion, PolynomialReference) else 0.0
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


# Transitions from any jets to any reference.

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


# What is refused.

TIMES = np.array([0.3, 1.0, 1.4, 2.5])
POSITIONS, VELOCITIES, ACCELERATIONS = np.random.default_rng(4).normal(size=(3, 4, 3))
VELOCITIES[-1] = 0.0
START = np.ones((5, 3))
NAN = np.where(np.arange(12).reshape(4, 3) == 7, np.nan, POSITIONS)
JETS = RUNNING.jets(0.0)

BAD: dict[str, tuple[Callable[[], object], tuple[str, ...]]] = {
    "sine-lengths": (lambda: fjr.Sine((1.0, 2.0), (1.0, 2.0, 3.0)), ("(2,)", "(3,)")),
    "sine-nan": (lambda: fjr.Sine(np.nan, 1.0), ("amplitude", "nan", "finite")),
    "sine-word": (lambda: fjr.Sine(1.0, "slow"), ("frequency", "slow", "numbers")),
    "multi-vector": (lambda: fjr.MultiSine([1.0], 1.0), ("amplitude", "(1,)", "(m, n)")),
    "multi-shape": (lambda: fjr.MultiSine([[1.0, 2.0]], [[1.0]]), ("frequency", "(1, 1)", "(1, 2)")),
    "multi-offset": (lambda: fjr.MultiSine([[1.0, 2.0]], 1.0, 0.0, (1, 2, 3)), ("offset", "(3,)", "(2,)")),
    "points": (lambda: fjr.PointToPoint((0, 0), (1, 1, 1), 1.0), ("q1", "(3,)", "(2,)")),
    "points-scalar": (lambda: fjr.PointToPoint(0.0, 1.0, 1.0), ("q0", "()", "(n,)")),
    "duration": (lambda: fjr.PointToPoint((0,), (1,), 0.0), ("duration", "0.0 s", "positive")),
    "dwell": (lambda: fjr.PointToPoint((0,), (1,), 1.0, -1.0), ("dwell", "-1.0 s", "0 or more")),
    "circle-one": (lambda: fjr.Circle((0.0,), 0.5, 1.0), ("centre", "1 entry", "2 or more")),
    "circle-radius": (lambda: fjr.Circle((0.0, 0.0), np.nan, 1.0), ("radius", "nan", "finite")),
    "circle-ramp": (lambda: fjr.Circle((0.0, 0.0), 0.5, 1.0, ramp=0.0), ("ramp", "0.0 s", "positive")),
    "hold": (lambda: fjr.Hold([[1.0]]), ("q", "(1, 1)", "(n,)")),
    "standing": (lambda: fjr.standing((1.0, 2.0), (1.0, 2.0, 3.0)), ("dq", "(3,)", "(2,)")),
    # splines
    "times stall": (lambda: fjr.Spline([0.3, 1.0, 1.0, 2.5], POSITIONS), ("1.0 s at point 1", "1.0 s at point 2")),
    "times short": (lambda: fjr.Spline(TIMES[1:], POSITIONS), ("times", "(3,)", "(4,)")),
    "times nan": (lambda: fjr.Spline(np.full(4, np.nan), POSITIONS), ("times", "nan", "finite")),
    "times at start": (lambda: fjr.Spline(TIMES - 0.3, POSITIONS, start=START), ("times", "0.0 s", "more than 0")),
    "too close": (lambda: fjr.Spline(1e-80 * np.arange(4), POSITIONS), ("1e-80 s at point 1", "at least 1e-06 s")),
    "too large": (lambda: fjr.Spline(TIMES, 1e307 * POSITIONS), ("positions", "not finite", "smaller")),
    "one point": (lambda: fjr.Spline(TIMES[:1], POSITIONS[:1]), ("times", "1 point", "at least 2")),
    "no points": (lambda: fjr.Spline(TIMES[:0], POSITIONS[:0]), ("positions", "(0, 3)", "(k, n)")),
    "flat": (lambda: fjr.Spline(TIMES, POSITIONS[:, 0]), ("positions", "(4,)", "(k, n)")),
    "nan": (lambda: fjr.Spline(TIMES, NAN), ("positions", "nan", "point 2", "joint 1", "finite")),
    "ragged": (lambda: fjr.Spline(TIMES, [[1.0, 2.0], [1.0]]), ("positions", "numbers")),
    "velocities": (lambda: fjr.Spline(TIMES, POSITIONS, VELOCITIES[1:]), ("velocities", "(3, 3)", "(4, 3)")),
    "moving end": (lambda: fjr.Spline(TIMES, POSITIONS, VELOCITIES + 1.0), ("1.0", "zeros at the last point")),
    "start": (lambda: fjr.Spline(TIMES, POSITIONS, start=START[:4]), ("start", "(4, 3)", "(5, 3)")),
    "start nan": (lambda: fjr.Spline(TIMES, POSITIONS, start=START * np.inf), ("start", "inf", "finite")),
    # samples
    "tolerance": (lambda: fjr.SampledMotion([0, 1], [[0], [1]], -1.0), ("tolerance is -1.0; expected 0 or more",)),
    "late": (lambda: fjr.SampledMotion([5, 6], [[0], [1]], 0.0), ("times begins with 5.0 s; expected 0",)),
    "tolerances": (
        lambda: fjr.SampledMotion([0, 1], [[0], [1]], [1, 1]),
        ("tolerance has shape (2,); expected a scalar or (1,)",),
    ),
    # transitions
    "at once": (lambda: fjr.transition(JETS, 0.0, RUNNING, 0.0), ("duration", "0.0 s", "positive")),
    "endless": (lambda: fjr.transition(JETS, 0.0, RUNNING, np.inf), ("duration", "inf", "finite")),
    "no time": (lambda: fjr.transition(JETS, 1e9, RUNNING, 1e-9), ("duration", "1e-09", "longer")),
    "never": (lambda: fjr.transition(JETS, np.nan, RUNNING, 1.0), ("t0", "nan", "finite")),
    "jets": (lambda: fjr.transition(np.zeros((5, 3)), 0.0, RUNNING, 1.0), ("jets0", "(5, 3)", "(5, 2)")),
    "jets nan": (lambda: fjr.transition(np.full((5, 2), np.nan), 0.0, RUNNING, 1.0), ("jets0", "nan", "finite")),
    "shift": (lambda: fjr.time_shifted(RUNNING, np.nan), ("t0 is nan; expected finite",)),
    # limits
    "order": (lambda: fjr.MotionLimits((1.0,), (-1.0,)), ("lower", "[1.0]", "upper", "[-1.0]", "lower <= upper")),
    "length": (lambda: fjr.MotionLimits((-1.0, -1.0), (1.0, 1.0, 1.0)), ("lower", "[-1.0, -1.0]", "3")),
    "limit nan": (lambda: fjr.MotionLimits((-1.0,), (np.nan,)), ("upper", "nan", "infinite for none")),
    "negative": (lambda: fjr.MotionLimits((-1.0,), (1.0,), (-2.0,)), ("velocity", "-2.0", "no negative")),
    "limit word": (lambda: fjr.MotionLimits((-1.0,), (1.0,), 1.0, "fast"), ("acceleration", "fast", "numbers")),
    "other joints": (
        lambda: fjr.check_motion(fjr.Hold((0.0,)), fjr.MotionLimits((-10.0, -10.0), 9.0)),
        ("limits are of 2 joints; expected those of the reference, 1",),
    ),
    "few harmonics": (lambda: RestingSeries(1.0, (1, 2)), ("the series has 2 harmonics; expected 3 or more",)),
}


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_is_refused_in_one_sentence(what: str) -> None:
    make, words = BAD[what]
    refused(fjr.TrajectoryError, make, *words)
