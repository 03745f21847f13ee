# SPDX-License-Identifier: Apache-2.0
"""A term has the coefficient of least squares with all columns; a slipping element loses the work of its loop."""

from __future__ import annotations

import numpy as np
import pytest

from fjr_identification.estimation.lack_of_fit import Rows, slipping_elements


@pytest.mark.parametrize("columns", [0, 3])
@pytest.mark.parametrize("added", [1, 2])
def test_a_term_is_that_of_least_squares_with_all_columns(columns: int, added: int) -> None:
    random = np.random.default_rng(columns + added)
    X, T, errors = (random.standard_normal(shape) for shape in ((200, columns), (200, added), 200))
    term = Rows(errors, X, np.arange(200) // 20).term(T)
    both = np.hstack([X, T])
    fitted = np.linalg.lstsq(both, errors, rcond=None)[0]
    np.testing.assert_allclose(term.c, fitted[columns:], atol=1e-12)
    assert term.log_stiffness == pytest.approx(fitted[0] if columns else 0.0)
    before = errors - X @ np.linalg.lstsq(X, errors, rcond=None)[0]
    assert 1 - term.share == pytest.approx(np.sum((errors - both @ fitted) ** 2) / np.sum(before**2))


def test_a_term_without_effect_seldom_stands_out_and_one_with_effect_does() -> None:
    ratios = []
    for seed in range(200):
        random = np.random.default_rng(seed)
        X, T, noise = (random.standard_normal(shape) for shape in ((240, 3), (240, 1), 240))
        rows = [Rows(noise + effect * T[:, 0], X, np.arange(240) // 20) for effect in (0.0, 1.0)]
        ratios.append([each.term(T).ratio for each in rows])
    without, with_effect = np.array(ratios).T
    assert np.mean(without > 2.2) < 0.12
    assert np.min(with_effect) > 5


def test_a_slipping_element_loses_the_work_of_a_parallelogram_in_each_cycle() -> None:
    amplitude, slips = 3.0, np.array([0.5, 1.0, 4.0])
    zeta = amplitude * np.sin(np.linspace(0, 6 * np.pi, 6001))
    w = slipping_elements(zeta, slips)
    lost = np.sum((w[2000:-1] + w[2001:]) / 2 * np.diff(zeta[2000:])[:, None], axis=0) / 2
    np.testing.assert_allclose(lost, 4 * slips * np.maximum(amplitude - slips, 0.0), atol=1e-3)
