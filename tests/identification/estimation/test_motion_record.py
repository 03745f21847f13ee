# SPDX-License-Identifier: Apache-2.0
"""Uniform grid: jitter and lost samples are interpolated and reported; jumps and wrong units are refused."""

from __future__ import annotations

import numpy as np
import pytest

from fjr_core.errors import RecordError
from fjr_core.numerics.checks import Array
from fjr_identification.estimation.motion_record import on_uniform_grid

DT, K = 2e-3, 2000
GRID = DT * np.arange(K)


def motion(t: Array) -> Array:
    return np.column_stack([np.sin(7 * t), np.full(len(t), np.nan)])


def effort(t: Array) -> Array:
    """Return an effort that changes at each nominal sample."""
    return np.cos(5 * DT * np.floor(t / DT + 1e-9))[:, None]


def put(t: Array) -> tuple[float, Array, Array, tuple[str, ...]]:
    return on_uniform_grid("run.csv", t, effort(t), motion(t))


def test_uniform_samples_are_left_as_they_are() -> None:
    _, held, sampled, notes = put(GRID)
    assert np.array_equal(sampled, motion(GRID), equal_nan=True)
    assert np.array_equal(held, effort(GRID))
    assert notes == put(np.round(GRID, 5))[3] == ()


def test_jitter_is_interpolated_and_reported() -> None:
    t = GRID + DT * 0.3 * np.random.default_rng(1).uniform(-1, 1, K)
    t[0], t[-1] = 0.0, GRID[-1]
    dt, held, sampled, (note,) = on_uniform_grid("run.csv", t, np.ones((K, 1)), motion(t))
    assert dt == pytest.approx(DT)
    assert np.max(np.abs(sampled[:, 0] - motion(dt * np.arange(K))[:, 0])) < 1e-6
    assert np.all(np.isnan(sampled[:, 1]))
    assert held == pytest.approx(1.0)
    assert "interpolated to 2 ms: samples are up to 0.6" in note


def test_lost_samples_are_interpolated_and_counted() -> None:
    kept = np.delete(np.arange(K), [500, 501, 900])
    _, held, sampled, (note,) = put(GRID[kept])
    assert len(sampled) == K
    assert note.endswith("3 are missing")
    assert np.max(np.abs(sampled[:, 0] - motion(GRID)[:, 0])) < 1e-6
    still = np.delete(np.arange(K - 1), [500, 501, 899, 900])
    assert held[still] == pytest.approx(effort(GRID)[still], abs=1e-9)


def test_mean_of_a_held_effort_is_its_integral() -> None:
    t = GRID + 0.25 * DT * (np.arange(K) % 2)
    u = np.random.default_rng(2).standard_normal((K, 1))
    dt, held, _, _ = on_uniform_grid("run.csv", t, u, motion(t))
    widths = np.append(np.diff(t), dt * len(held) - (t[-1] - t[0]))
    assert dt * held.sum() == pytest.approx(float(widths @ u[:, 0]), abs=1e-2 * DT * K)


REFUSED = {
    "time jumps by 0.502 s at sample 501": np.where(GRID > 1.0, GRID + 0.5, GRID),
    "time runs back by 0.498 s at sample 501": np.where(GRID > 1.0, GRID - 0.5, GRID),
    "time stands still at sample 1": np.maximum(GRID, 0.1),
    "is the unit of the time right?": GRID * 1e-6,
    "expected 1e-05 to 0.1 s (is the unit of the time right?)": GRID * 1e3,
    "expected one sample period": np.where(GRID > 1.0, 2 * GRID - 1.0, GRID),
    "the time of sample 7 is not finite": np.where(GRID[7] == GRID, np.nan, GRID),
    "of the steps are longer than the usual 2 ms; expected at most 1%": GRID[np.arange(K) % 10 > 0],
    "has 1 samples; expected at least 2": GRID[:1],
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_other_times_are_refused_in_one_sentence(sentence: str) -> None:
    t = REFUSED[sentence]
    with pytest.raises(RecordError, match="^run.csv") as caught:
        on_uniform_grid("run.csv", t, np.zeros((len(t), 1)), np.zeros((len(t), 1)))
    assert sentence in str(caught.value)
