# SPDX-License-Identifier: Apache-2.0
"""The descent ends at least as near to the record as the truth; its steps are those of non-negative least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from core.oracles.elastic_joint import TRUTH
from fjr_core.numerics.checks import Array
from fjr_identification.estimation.multiple_shooting import FEWEST, Problem, Segment
from fjr_identification.estimation.optimise import LAGS, Reversals, bounded_step, optimise
from identification.estimation.test_filtered_fit import JOINT, NOISE, setup_of


def problem_at_truth() -> tuple[Problem, Array]:
    """Return segments of a record of the joint, with the parameters z that made it."""
    setup = setup_of()
    true = {**setup.prior, **{name: np.array([getattr(JOINT, field)]) for name, field in TRUTH.items()}}
    return setup.problem(true), setup.coordinates.of_values(true)


def test_a_part_has_the_beginnings_of_some_segments() -> None:
    problem, z = problem_at_truth()
    part = problem.part(2, 4)
    assert [each.first for each in part.segments] == [each.first for each in problem.segments[::2]]
    assert [each.count for each in part.segments] == [max(FEWEST, each.count // 4) for each in problem.segments[::2]]
    found, whole = (each.compare(0, z, each.filtered[0], np.full(2, NOISE)) for each in (part, problem))
    assert found is not None
    assert whole is not None
    np.testing.assert_array_equal(found.predicted, whole.predicted[:, : found.predicted.shape[1]])


def wrong_start(problem: Problem, z: Array) -> Array:
    start = z + 0.3 * problem.coordinates.width * np.random.default_rng(4).standard_normal(len(z))
    return np.where(np.abs(z) > 1, z + 0.1, np.clip(start, 0.0, None))


def test_the_optimum_fits_as_well_as_the_truth_and_with_residuals_below_the_steps_of_the_encoders_too() -> None:
    problem, z = problem_at_truth()
    found = optimise(problem, wrong_start(problem, z), problem.filtered)
    true = problem.evaluate(z, problem.filtered, problem.rough_noise)
    assert true is not None
    assert found.converged
    assert found.cost < true.cost
    assert np.all(found.noise < 1.5 * NOISE)
    coarse = replace(problem, floor=np.full(2, 3 * NOISE))
    found = optimise(coarse, wrong_start(problem, z), problem.filtered)
    assert found.converged
    assert np.all(found.noise < 1.1 * coarse.floor)
    stiffness = [name for name, _ in problem.coordinates.free].index("joint_stiffness")
    assert abs(found.z[stiffness] - z[stiffness]) < 1e-3


def test_the_step_ends_at_the_nonnegative_least_squares_of_scipy() -> None:
    random = np.random.default_rng(0)
    for _ in range(50):
        J, r, z = random.standard_normal((12, 4)), random.standard_normal(12), np.full(4, 0.2)
        expected, _ = nnls(J, r)
        step = bounded_step(J.T @ J, J.T @ (r - J @ z), z, np.ones(4, dtype=bool))
        np.testing.assert_allclose(z + step, expected, atol=1e-6)


def test_entries_without_a_bound_may_become_negative_and_damping_shortens_each_by_its_own_curvature() -> None:
    H, g = np.diag([4.0, 1.0]), np.array([-8.0, -3.0])
    np.testing.assert_allclose(bounded_step(H, g, np.ones(2), np.array([False, True])), [-2.0, -1.0])

    H, g, free = np.diag([4.0, 100.0]), np.array([4.0, 100.0]), np.zeros(2, dtype=bool)
    step = bounded_step(H, g, np.zeros(2), free, damping=1.0)
    np.testing.assert_allclose(step, [0.5, 0.5])


def test_information_that_rounding_makes_indefinite_has_a_step() -> None:
    H, free = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-14]]), np.zeros(2, dtype=bool)
    assert np.linalg.eigvalsh(H)[0] < 0
    assert bounded_step(H, np.ones(2), np.zeros(2), free).sum() == pytest.approx(1.0)


# Jumps at reversals are those of a new integration; eliminated, they are generalised least squares.

WIDTH = np.repeat([1e-2, 2e-2], len(LAGS))


@pytest.fixture(scope="module")
def reversing() -> tuple[Reversals, Segment, Array, Array, dict[str, Array], Array]:
    """Return a segment whose joint reverses, its motion, parameters, and derivatives of both positions."""
    problem, z = problem_at_truth()
    p, x0 = problem.coordinates.parameters(z), problem.filtered
    for segment, x in zip(problem.segments, x0, strict=True):
        first, samples = segment.first - segment.pad, segment.count + 2 * segment.pad
        motion = problem.shooting(x, segment.effort, first, samples, p)
        assert motion is not None
        at = slice(segment.pad, segment.pad + segment.count)
        if np.ptp(np.sign(motion[0][at, 2])) == 2:
            J = np.moveaxis(motion[1][at, :2], 1, 0)
            return Reversals(problem.shooting, WIDTH), segment, *motion, p, J
    raise AssertionError("no segment reverses")


def test_a_jump_changes_the_signals_as_a_new_integration_from_it(reversing: tuple) -> None:
    reversals, segment, X, S, p, J = reversing
    N, places = reversals.responses(segment, X, S, p, J)
    reversal, sides = np.nonzero(np.diff(np.sign(X[:, 2:]), axis=0))
    jumps = [
        (k - segment.pad + round(lag / segment.record.dt), 2 * i + side)
        for i, lag in enumerate(LAGS.tolist())
        for k, side in zip(reversal.tolist(), sides.tolist(), strict=True)
    ]
    jumps = [(k, place) for k, place in jumps if 0 <= k < segment.count]
    assert places.tolist() == [place for _, place in jumps]
    for column, (k, place) in enumerate(jumps):
        e, step = segment.pad + k + 1, 1e-2 * WIDTH[place] * np.eye(4)[2 + place % 2]
        first, samples = segment.first - segment.pad + e, segment.pad + segment.count - e
        ends = [reversals.shooting(X[e] + sign * step, segment.effort, first, samples, p) for sign in (1, -1)]
        slopes = (ends[0][0] - ends[1][0])[:-1, :2].T / 2e-2
        assert not N[:, : k + 1, column].any()
        np.testing.assert_allclose(N[:, k + 1 :, column], slopes, atol=0.02 * np.max(np.abs(slopes), initial=1e-12))


def test_eliminated_jumps_are_generalised_least_squares(reversing: tuple) -> None:
    reversals, segment, X, S, p, J = reversing
    noise = np.array([1e-4, 2e-4])
    J, r = J / noise[:, None, None], np.random.default_rng(0).standard_normal(J.shape[:2])
    white_J, white_r, whitening = reversals.whitened(segment, X, S, p, J, r, noise)
    N = reversals.responses(segment, X, S, p, J)[0].reshape(r.size, -1)
    W, columns, white = np.linalg.inv(np.eye(r.size) + N @ N.T), J.reshape(r.size, -1), white_J.reshape(r.size, -1)
    np.testing.assert_allclose(white.T @ white, columns.T @ W @ columns, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(white.T @ white_r.ravel(), columns.T @ W @ r.ravel(), rtol=1e-6, atol=1e-6)
    left = r - whitening.explained
    assert np.sum(left**2) + whitening.penalty == pytest.approx(r.ravel() @ W @ r.ravel())
    assert whitening.counts.sum() == N.shape[1]
    covariance = np.linalg.inv(np.eye(N.shape[1]) + N.T @ N)
    jumps = covariance @ N.T @ r.ravel()
    expected = np.sum((jumps**2 + np.diag(covariance)) * WIDTH[reversals.responses(segment, X, S, p, J)[1]] ** 2)
    assert whitening.squares.sum() == pytest.approx(expected)
