# SPDX-License-Identifier: Apache-2.0
"""V against its bound, also where V is zero, and the energies of a run some of whose commands are missing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fjr_monitor.report.performance import Storage, steps, storage

T = 1e-3 * np.arange(4000)
BETA = 5.0


def stored(V: Any) -> Storage:
    """Return the metrics of V; a warning of NumPy fails the test."""
    with np.errstate(all="raise", under="ignore"):
        found = storage(T, np.asarray(V, dtype=float), BETA, proven=True)
    assert found is not None
    return found


def test_decay_along_the_bound_and_slower_is_measured() -> None:
    faster, slower = stored(0.3 * np.exp(-12 * T)), stored(0.3 * np.exp(-8 * T))
    assert faster.measured_decay_rate_per_s == pytest.approx(12, rel=1e-9)
    assert (faster.leaves_bound_at_s, faster.largest_ratio_to_bound_before) == (None, 1.0)
    assert (slower.leaves_bound_at_s, slower.measured_decay_rate_per_s) == (pytest.approx(1e-3), pytest.approx(8))
    floor = stored(0.3 * np.maximum(np.exp(-12 * T), 1e-6))
    assert floor.leaves_bound_at_s == pytest.approx(np.log(1e6) / 10, abs=2e-3)
    assert floor.max_relative_after_2s == pytest.approx(1e-6)


def test_robot_that_starts_on_its_reference_is_on_the_bound_until_it_leaves_the_reference() -> None:
    still, pushed = stored(0 * T), stored(np.where(T > 1.0, 1e-6, 0.0))
    assert (still.leaves_bound_at_s, still.measured_decay_rate_per_s, still.max_relative_after_2s) == (None, None, 0.0)
    assert pushed.leaves_bound_at_s == pytest.approx(1.001)
    assert pushed.measured_decay_rate_per_s is None
    assert stored(np.where(T > 1.0, 0.0, 0.3)).leaves_bound_at_s is None  # V reaches zero


def test_stored_energy_is_the_supplied_less_the_dissipated_plus_the_residual_where_commands_are_missing() -> None:
    rng, k = np.random.default_rng(0), 50
    certificate = SimpleNamespace(dissipated=rng.random(k), H=rng.random(k), held_rate=lambda u: u[1:, 0])
    part: Any = SimpleNamespace(t=T[:k], V=rng.random(k), position=rng.random((k, 4)), u=rng.normal(size=(k, 2)))
    part.certificate, part.u_applied, part.lockstep, part.begin = certificate, None, True, 0
    part.u[[7, 8, 20]] = np.nan
    found = steps(part, np.diag([1.0, 2.0]), BETA, np.zeros(4))
    assert np.isnan(found["watts"][[8, 9, 21], 0]).all()
    supplied, dissipated, kept, residual = found["joules"][-1]
    assert kept == pytest.approx(supplied - dissipated + residual, abs=1e-12)
    known = np.isfinite(part.u[:-1, 0])
    assert kept == pytest.approx(np.diff(certificate.H)[known].sum(), abs=1e-12)
