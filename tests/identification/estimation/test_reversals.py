# SPDX-License-Identifier: Apache-2.0
"""Jumps at reversals are those of a new integration; eliminated, they are generalised least squares."""

from __future__ import annotations

import numpy as np
import pytest

from fjr_core.numerics.checks import Array
from fjr_identification.estimation.multiple_shooting import Segment
from fjr_identification.estimation.reversals import LAGS, Reversals
from identification.estimation.test_optimise import problem_at_truth

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
