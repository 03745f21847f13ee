# SPDX-License-Identifier: Apache-2.0
"""Motions from samples: C^4, within the tolerance, free of the noise of rounding, at rest after the end."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.motions.inverse_dynamics import effort_demand, inverse_dynamics
from fjr_core.motions.spline import waypoints

T = np.arange(10_001) / 1000  # s: 10 s at 1 kHz
LINK = fjr.single_link(stiffness=31.0)


def sampled(q: np.ndarray, decimals: int = 6, tolerance: float = 1e-3) -> fjr.SampledMotion:
    return fjr.SampledMotion(T[: len(q)], np.round(q, decimals).reshape(len(q), -1), tolerance)


NAMES = ("rounded sine", "two joints", "noise", "waypoints", "waypoints that end at speed")


@cache
def motions() -> dict[str, fjr.SampledMotion]:
    """Return the motions by name; no worker but that of this file fits them."""
    rng = np.random.default_rng(3)
    made = (
        sampled(np.sin(T)),
        sampled(np.stack([np.sin(2 * T), np.cos(3 * T)], axis=1)[:4000]),
        fjr.SampledMotion(T[::10], (np.sin(T[::10]) + 0.01 * rng.normal(size=1001))[:, None], 0.1),
        fjr.SampledMotion([0.0, 1.0, 1.5, 4.0], rng.normal(size=(4, 2)), 1e-3),
        fjr.SampledMotion([0.0, 1.0, 2.0], rng.normal(size=(3, 2)), 1e-3, rng.normal(size=(3, 2))),
    )
    return dict(zip(NAMES, made, strict=True))


@pytest.fixture(params=NAMES)
def motion(request: pytest.FixtureRequest) -> fjr.SampledMotion:
    return motions()[request.param]


def test_a_motion_is_c4_between_all_its_pieces(motion: fjr.SampledMotion) -> None:
    edges = motion.table[0][1:-1]
    before, after = (motion.jets(np.nextafter(edges, way)) for way in (-np.inf, np.inf))
    scale = np.abs(motion.knot_jets).max(axis=(0, 2))[:, None]
    assert np.all(np.abs(before - after) < 1e-9 * np.maximum(scale, 1.0))


def test_a_motion_comes_to_rest_with_four_continuous_derivatives(motion: fjr.SampledMotion) -> None:
    before = motion.jets(np.nextafter(motion.end, 0.0))
    np.testing.assert_allclose(before[1:], 0.0, atol=1e-9 * (1.0 + np.abs(motion.knot_jets).max()))
    np.testing.assert_array_equal(motion.jets(motion.end + 1.0), fjr.standing(motion.jets(motion.end)[0]))


def test_a_motion_is_within_the_tolerance_and_reports_its_deviation(motion: fjr.SampledMotion) -> None:
    deviation = np.abs(motion.jets(motion.times)[:, 0] - motion.positions).max(axis=0)
    np.testing.assert_allclose(deviation, motion.deviation, atol=1e-12)
    assert np.all(motion.deviation <= motion.tolerance)


@pytest.mark.parametrize("decimals", [4, 5, 6, 8])
def test_rounding_of_samples_does_not_reach_the_effort(decimals: int) -> None:
    """A sine at 1 kHz asks for 0.69 N m; interpolating its six decimals asks for more than 100 N m."""
    smooth = effort_demand(LINK, sampled(np.sin(T), decimals), 0.0, T[-1])
    along = inverse_dynamics(LINK).map(len(T))(*(row.T for row in fjr.Sine([1.0], 1.0).jets(T).swapaxes(0, 1)))
    assert smooth.peak == pytest.approx([np.abs(along[-1].full()).max()], rel=0.05)
    assert smooth.peak == pytest.approx([0.69], rel=0.05)


def test_a_reference_is_recovered_from_its_rounded_samples_and_rests_exactly_where_they_rest() -> None:
    motion = fjr.PointToPoint((0.3,), (1.0,), 2.0, 0.5)
    found = sampled(motion.jets(T[:3500])[:, 0])
    assert found.end == pytest.approx(T[3499])
    for order, error in enumerate((1e-6, 1e-5, 1e-3, 0.05, 5.0)):
        np.testing.assert_allclose(found.jets(T[:3500])[:, order], motion.jets(T[:3500])[:, order], atol=error)
    for t in (0.0, found.end):
        np.testing.assert_array_equal(found.jets(t)[1:], np.zeros((4, 1)))


def test_a_motion_that_ends_at_speed_has_few_pieces_and_stops_with_moderate_efforts() -> None:
    motion = motions()["rounded sine"]
    assert len(motion.knot_times) < 40
    along, whole = effort_demand(LINK, motion, 0.0, 9.99), effort_demand(LINK, motion)
    assert T[-1] < motion.end < 2 * T[-1]
    assert whole.peak[0] < 1.5 * along.peak[0]


def test_waypoints_are_interpolated_with_their_velocities() -> None:
    motion = motions()["waypoints that end at speed"]
    assert not motion.smoothed
    jets = motion.jets(motion.times)
    np.testing.assert_allclose(jets[:, 0], motion.positions, atol=1e-14)
    np.testing.assert_allclose(jets[:, 1], np.asarray(motion.velocities), atol=1e-13)


def test_each_joint_has_a_tolerance_of_its_own() -> None:
    """A prismatic joint with 0.1 mm of noise beside a revolute one with 10 mrad."""
    noise = np.random.default_rng(3).normal(size=(1001, 2)) * [0.01, 1e-4]
    q = np.stack([np.sin(T[::10]), 0.1 * np.sin(T[::10])], axis=1)
    motion = fjr.SampledMotion(T[::10], q + noise, [0.05, 5e-4])
    assert motion.smoothed
    assert np.all(motion.deviation <= [0.05, 5e-4])
    assert np.all(np.abs(motion.jets(T[::10])[:, 0] - q).max(axis=0) < [0.01, 1e-4])
    for tolerance in ([0.05, 1e-5], [0.05, 0.0], 5e-4):
        assert not fjr.SampledMotion(T[::10], q + noise, tolerance).smoothed


@pytest.mark.parametrize("name", [name for name in NAMES if name != "noise"])
def test_a_spline_through_its_waypoints_is_the_motion(name: str) -> None:
    motion = motions()[name]
    times, rows = waypoints(motion, 1e-6)
    t = np.linspace(0.0, motion.end, 3001)[1:]
    spline = fjr.Spline(times, *rows)
    assert np.abs(spline.jets(t)[:, 0] - motion.jets(t)[:, 0]).max() < 2e-6
    np.testing.assert_array_equal(rows[1, -1], 0.0)
    assert len(times) < 2000


@pytest.mark.parametrize("tolerance", [1e-3, 0.0])
def test_a_motion_that_ends_at_its_turning_point_rests_there(tolerance: float) -> None:
    """Its last acceleration is not zero; the arm does not come to rest elsewhere."""
    t = np.arange(0, 1.0005, 1e-3 if tolerance else 0.1)
    motion = fjr.SampledMotion(t, 0.25 * (1 - np.cos(np.pi * t))[:, None], tolerance=tolerance)
    np.testing.assert_allclose(motion.jets(100.0), [[0.5], [0], [0], [0], [0]], atol=1e-5)
    beyond = np.abs(motion.jets(np.linspace(1, 4, 301))[:, 0] - 0.5)
    assert beyond.max() < 0.06
