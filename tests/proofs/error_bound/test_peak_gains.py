# SPDX-License-Identifier: Apache-2.0
"""Peak gains of loops in closed form: geometric series, and a direct sum for matrices that change."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_proofs.error_bound.cells import cells_of
from fjr_proofs.error_bound.peak_gains import CellModels, peak_gains

T = 0.01
CELLS = cells_of(fjr.Sine(1.0, 2 * np.pi), T, verified=True)  # 100 cells of one sample
ALL = np.arange(CELLS.count)


def models(loop: np.ndarray, torque: np.ndarray, effort: np.ndarray, output: np.ndarray) -> CellModels:
    """Return models (c, ..) whose torque acts alike during a sample."""
    return CellModels(loop, torque, torque, 0 * torque, effort, output)


@pytest.mark.parametrize("a", [0.9, -0.9])
@pytest.mark.parametrize("blocks", [3, 40])
def test_gains_of_a_scalar_loop_are_geometric_series(a: float, blocks: int) -> None:
    """1 + |a| + |a|^2 + .., however few of its terms are summed."""
    loop, torque, effort, output = (np.full((CELLS.count, 1, 1), value) for value in (a, 3.0, 0.5, 2.0))
    gains = peak_gains(models(loop, torque, effort, output), CELLS, T, blocks, ALL)
    whole = 1 / (1 - abs(a))
    state = [3.0 * T * whole, 0.5 * whole]
    assert gains[0, :2] == pytest.approx(state, rel=1e-8)
    assert gains[1, :2] == pytest.approx(2 * np.array(state), rel=1e-8)


def test_a_sum_over_changing_matrices_is_that_of_the_worst_end() -> None:
    rng = np.random.default_rng(0)
    S, m, n = 3, 2, 1
    loop = 0.4 * rng.uniform(-1, 1, (CELLS.count, S, S))
    torque, effort = rng.uniform(-1, 1, (CELLS.count, S, m)), rng.uniform(-1, 1, (CELLS.count, S, n))
    gains = peak_gains(models(loop, torque, effort, loop), CELLS, T, 60, ALL)
    sums = np.zeros((CELLS.count, S, m + n))
    for final in ALL:
        X = np.eye(S)
        for lag in range(200):
            i = (final - lag) % CELLS.count
            sums[final] += np.abs(np.hstack([T * X @ torque[i], X @ effort[i]]))
            X = X @ loop[i]
    assert gains[:S, : m + n] == pytest.approx(sums.max(axis=0), rel=1e-6)


def test_a_loop_that_does_not_contract_has_no_gains() -> None:
    one = np.ones((CELLS.count, 1, 1))
    assert np.all(np.isinf(peak_gains(models(one, one, one, one), CELLS, T, 10, ALL)))
