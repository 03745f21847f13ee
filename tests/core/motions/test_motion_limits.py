# SPDX-License-Identifier: Apache-2.0
"""Motion bounds are exact; limits are checked over the whole motion, and errors name joint, point or time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from core.motions import cases
from fjr_core.motions.reference import Reference
from fuzzing import refused

RNG = np.random.default_rng(5)
TIMES = np.array([0.4, 1.0, 2.2, 3.0])
SPLINE = fjr.Spline(TIMES, RNG.normal(size=(4, 2)), start=RNG.normal(size=(5, 2)))
NAMES = ("half still", "one row", "series", "one way", "to and fro", "hold", "late")
REFERENCES: dict[str, Reference] = {
    **{name: cases.REFERENCES[name] for name in NAMES},
    "circle": fjr.Circle((0.1, 0.2), 0.5, 3.0, 0.4, 1.5),
    "joined": fjr.transition(RNG.normal(size=(5, 2)), 0.0, cases.RUNNING, 1.0),
    "spline": SPLINE,
    "shifted spline": fjr.time_shifted(SPLINE, 0.7),
}
references = pytest.mark.parametrize("reference", REFERENCES.values(), ids=REFERENCES)


@references
@pytest.mark.parametrize(("t0", "t1"), [(0.0, 10.0), (0.3, 1.1), (1.7, 1.9)])
def test_motion_bounds_agree_with_dense_samples(reference: Reference, t0: float, t1: float) -> None:
    samples = reference.jets(np.linspace(t0, t1, 20001))[:, :3]
    e = reference.motion_bounds(t0, t1)
    below, above = samples.min(axis=0) - e.lower, e.upper - samples.max(axis=0)
    assert min(below.min(), above.min()) > -1e-12
    if reference is not REFERENCES["to and fro"]:  # its bounds hold for all times
        assert np.all(np.maximum(below, above) < 1e-4 * (1.0 + np.abs(samples).max(axis=0)))


@references
def test_motion_bounds_are_attained_at_their_times(reference: Reference) -> None:
    e = reference.motion_bounds(0.0, np.inf)
    for values, at in ((e.lower, e.lower_at), (e.upper, e.upper_at)):
        for row, joint in np.ndindex(values.shape):
            assert at[row, joint] >= 0.0
            assert reference.jets(at[row, joint])[row, joint] == pytest.approx(values[row, joint], abs=1e-10)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("t0", "t1"), [(0.0, np.inf), (0.7, 1.3)])
def test_bounds_of_any_spline_enclose_it_and_its_hulls_enclose_them(seed: int, t0: float, t1: float) -> None:
    """The hulls are close for even points."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(10.0 ** rng.uniform(-1.5, 0.7, 8))
    wild = fjr.Spline(times, rng.normal(size=(8, 2)), start=rng.normal(size=(5, 2)))
    even = 0.1 * np.arange(1, 41)
    tame = fjr.Spline(even, np.sin(even[:, None] + rng.uniform(0, 6, 2)), start=fjr.standing(rng.normal(size=2)))
    for reference in (wild, tame):
        e, (lower, upper) = reference.motion_bounds(t0, t1), reference.hull(t0, t1)
        samples = reference.jets(np.linspace(t0, min(t1, reference.end), 20001))[:, :3]
        assert np.all(e.lower <= samples.min(axis=0) + 1e-6 * np.ptp(samples, axis=0))
        assert np.all(e.upper >= samples.max(axis=0) - 1e-6 * np.ptp(samples, axis=0))
        rounding = 1e-9 * (1.0 + np.abs(e.upper) + np.abs(e.lower))
        assert np.all(lower <= e.lower + rounding)
        assert np.all(upper >= e.upper - rounding)
        if reference is tame and t0 == 0.0:
            assert np.all(upper - lower < np.array([[1.1], [1.1], [2.0]]) * (e.upper - e.lower))


def test_bounds_of_sums_of_sines_are_tight() -> None:
    reference = fjr.MultiSine([[0.5], [0.3]], [[1.0], [np.sqrt(7)]], 0.2, (0.1,))
    samples = reference.jets(np.linspace(0.0, 600.0, 100001))[:, :3]
    e = reference.motion_bounds(0.0, np.inf)
    assert np.all(samples.min(axis=0) >= e.lower)
    assert np.all(samples.max(axis=0) <= e.upper)
    np.testing.assert_allclose(samples.max(axis=0), e.upper, rtol=1e-2)


@references
@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("what", ["lower", "upper", "velocity", "acceleration"])
def test_references_within_the_limits_pass_and_a_slightly_exceeded_limit_is_detected(
    reference: Reference, joint: int, what: str
) -> None:
    e = reference.motion_bounds(0.0, np.inf)
    limits = {"lower": e.lower[0], "upper": e.upper[0]}
    limits |= {name: np.maximum(e.upper[row], -e.lower[row]) for row, name in ((1, "velocity"), (2, "acceleration"))}
    fjr.check_motion(reference, fjr.MotionLimits(**limits))
    margin = (1.0 if what == "lower" else -1.0) * (1e-6 * np.ptp(e.upper) + 1e-9)
    limits[what] = limits[what].copy()
    limits[what][joint] += margin
    if limits[what][joint] < 0 and what not in ("lower", "upper"):
        return  # this joint does not move
    if not np.all(limits["lower"] <= limits["upper"]):
        other = "lower" if what == "upper" else "upper"
        limits[other] = np.where(np.arange(2) == joint, limits[what], limits[other])
    names = ("shoulder", "elbow")
    assert f"'{names[joint]}'" in sentence(reference, fjr.MotionLimits(**limits), 0.0, np.inf, names)


def sentence(reference: Reference, limits: fjr.MotionLimits, *arguments: Any) -> str:
    return refused(fjr.TrajectoryError, lambda: fjr.check_motion(reference, limits, *arguments))


def test_the_message_names_point_joint_value_and_limit() -> None:
    q = [[0.0, 0.0], [0.5, 0.1], [0.3, 3.2]]
    reference = fjr.Spline([1.0, 2.0, 3.0], q, [[0, 0], [-4, 0], [0, 0]], [[0, 0], [0, 9], [0, 0]])
    joints = ("shoulder", "elbow")
    rows = {
        "point 2 of joint 'elbow' asks for 3.2 rad; its limit is 2.9 rad": fjr.MotionLimits(-9.0, (9.0, 2.9)),
        "point 0 of joint 'elbow' asks for 0 rad; its limit is 0.05 rad": fjr.MotionLimits((-9.0, 0.05), 9.0),
        "point 1 of joint 'shoulder' asks for 4 rad/s; its limit is 1.5 rad/s": fjr.MotionLimits(-9.0, 9.0, (1.5, 9)),
        "point 1 of joint 'elbow' asks for 9 rad/s^2; its limit is 8 rad/s^2": fjr.MotionLimits(-9.0, 9.0, 9, (99, 8)),
    }
    for expected, limits in rows.items():
        assert sentence(reference, limits, 0.0, np.inf, joints) == expected


def test_between_points_the_message_names_the_time() -> None:
    reference = fjr.PointToPoint((0.0, 0.0), (0.1, 1.0), 2.0)
    limits = fjr.MotionLimits((-1.0, -1.0), 2.0, 1.0)
    expected = "joint 'elbow' would reach 1.23047 rad/s at 1 s; its limit is 1 rad/s"
    assert sentence(reference, limits, 0.0, np.inf, ("shoulder", "elbow")) == expected
    assert sentence(reference, limits).startswith("joint 1 would reach")
    spline = fjr.Spline([1.0, 2.0, 3.0], [[0.0], [1.0], [0.0]], [[0.0], [2.0], [0.0]])
    reached = spline.jets(np.linspace(2.0, 3.0, 1001))[:, 0].max()
    assert reached > 1.1
    assert f"joint 0 would reach {reached:.4g}" in sentence(spline, fjr.MotionLimits((-9.0,), 1.05))
    without_period = fjr.MultiSine([[0.5], [0.3]], [[1.0], [np.sqrt(2.0)]])
    expected = "joint 0 would reach 0.8 rad; its limit is 0.7 rad"  # at no time that is known
    assert sentence(without_period, fjr.MotionLimits((-1.0,), 0.7)) == expected


def test_barely_exceeded_limit_is_printed_with_enough_digits() -> None:
    words = sentence(fjr.Hold((1.0 + 1e-8,)), fjr.MotionLimits((-1.0,), 1.0))
    assert words == "joint 0 would reach 1.00000001 rad at 0 s; its limit is 1 rad"
    fjr.check_motion(fjr.Hold((1.0 + 1e-12,)), fjr.MotionLimits((-1.0,), 1.0))


def test_only_the_requested_interval_is_checked_and_points_keep_their_numbers() -> None:
    reference = fjr.Spline([1.0, 2.0, 4.0], [[5.0], [0.0], [0.5]])
    limits = fjr.MotionLimits((-1.0,), 1.0)
    assert "point 0" in sentence(reference, limits)
    fjr.check_motion(reference, limits, 2.0, 9.0)
    assert "would reach" in sentence(reference, limits, 1.5)
    later = fjr.Spline([1.0, 2.0, 3.0, 4.0], [[5.0], [0.0], [2.0], [0.0]])
    assert sentence(later, limits, 2.0, 9.0, ("a",)).startswith("point 2 of joint 'a' asks for 2 rad")


def test_motion_that_ends_at_a_limit_of_zero_is_within_it() -> None:
    """0.3 - (0.1 + 0.2) is -5.6e-17; rounding is relative to a limit, and at zero this would permit none."""
    fjr.check_motion(fjr.MultiSine([[0.1], [0.2]], 1.0, offset=(0.3,)), fjr.MotionLimits((0.0,), np.inf))
    assert "its limit is 0 rad" in sentence(fjr.Hold((-1e-9,)), fjr.MotionLimits((0.0,), 1.0))


def test_limits_of_the_robot_and_of_acceleration_apply() -> None:
    own = fjr.JointLimits(np.array([-1.0, -2.0]), np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([5.0, 6.0]))
    limits = fjr.MotionLimits.of(own, 2, 7.0)
    for name, expected in (("lower", [-1, -2]), ("upper", [1, 2]), ("velocity", [3, 4]), ("acceleration", [7, 7])):
        np.testing.assert_array_equal(getattr(limits, name), expected)
    fjr.check_motion(fjr.Sine((1e6, 1e6), 1.0), fjr.MotionLimits.of(None, 2))
    slides = replace(fjr.planar_two_link(), limits=own, prismatic=(True, False))
    expected = "joint 0 would reach -1.5 m at 4.712 s; its limit is -1 m"
    assert sentence(fjr.Sine((1.5, 0.1), 1.0), fjr.MotionLimits.of(slides.limits, 2, units=slides.units)) == expected
