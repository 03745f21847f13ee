# SPDX-License-Identifier: Apache-2.0
"""V against its bound, also where V is zero, and the energies of a run some of whose commands are missing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import held_efforts
from fjr_monitor.recording.columns import Columns
from fjr_monitor.report.performance import Storage, energy, steps, storage

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


def part_of(u: Array) -> Any:
    """Return a part in lock-step with these commands (k, 2), which V, H and the motion know nothing of."""
    rng, k = np.random.default_rng(0), len(u)
    certificate = SimpleNamespace(dissipated=rng.random(k), H=rng.random(k), held_rate=lambda u: u[1:, 0])
    part = SimpleNamespace(t=T[:k], V=rng.random(k), position=rng.random((k, 4)), u=u, held=held_efforts(u, None))
    part.certificate, part.u_applied, part.lockstep, part.begin = certificate, None, True, 0
    return part


def test_energy_is_supplied_by_the_effort_that_is_held_where_commands_are_missing() -> None:
    u, B_m = np.random.default_rng(1).normal(size=(50, 2)), np.diag([1.0, 2.0])
    u[[7, 8, 20]] = np.nan
    part = part_of(u)
    supplied, dissipated, kept, residual = steps(part, B_m, BETA, np.zeros(4))["joules"][-1]
    assert kept == pytest.approx(supplied - dissipated + residual, abs=1e-12)
    assert kept == pytest.approx(part.certificate.H[-1] - part.certificate.H[0], abs=1e-12)
    u[7:9], u[20] = u[6], u[19]
    assert supplied == pytest.approx((u[:-1] @ B_m * np.diff(part.position[:, 2:], axis=0)).sum(), abs=1e-12)


@pytest.mark.parametrize("known", [True, False])
def test_energies_are_unknown_if_no_command_is(known: bool) -> None:
    columns = Columns()
    columns.add(**steps(part_of(np.full((50, 2), 0.5 if known else np.nan)), np.eye(2), BETA, np.zeros(4)))
    assert (np.isfinite(list(vars(energy(columns)).values())) == known).all()
