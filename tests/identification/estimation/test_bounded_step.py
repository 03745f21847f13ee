# SPDX-License-Identifier: Apache-2.0
"""A bounded step is the maximum of its quadratic model among parameters that are not negative."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from fjr_identification.estimation.optimise import bounded_step


@pytest.mark.parametrize("seed", range(50))
def test_the_step_ends_at_the_nonnegative_least_squares_of_scipy(seed: int) -> None:
    random = np.random.default_rng(seed)
    J, r, z = random.standard_normal((12, 4)), random.standard_normal(12), np.full(4, 0.2)
    expected, _ = nnls(J, r)
    step = bounded_step(J.T @ J, J.T @ (r - J @ z), z, np.ones(4, dtype=bool))
    np.testing.assert_allclose(z + step, expected, atol=1e-6)


def test_entries_without_a_bound_may_become_negative() -> None:
    H, g = np.diag([4.0, 1.0]), np.array([-8.0, -3.0])
    np.testing.assert_allclose(bounded_step(H, g, np.ones(2), np.array([False, True])), [-2.0, -1.0])


def test_damping_shortens_each_entry_by_its_own_curvature() -> None:
    step = bounded_step(
        np.diag([4.0, 100.0]), np.array([4.0, 100.0]), np.zeros(2), np.zeros(2, dtype=bool), damping=1.0
    )
    np.testing.assert_allclose(step, [0.5, 0.5])
