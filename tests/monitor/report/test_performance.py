# SPDX-License-Identifier: Apache-2.0
"""V against its bound, energies of a run some of whose commands are missing, and counts of samples."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import held_efforts
from fjr_monitor.recording.bag import Bag
from fjr_monitor.recording.columns import Columns
from fjr_monitor.recording.files import Topic
from fjr_monitor.report.performance import Counts, Storage, counts, energy, steps, storage

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


# Missed, late, unanswered and lost samples are counted.


PERIOD = 1e-3


def counted(stamps: list[float], answers: list[float], lost: int, duration: float = 5 * PERIOD) -> Counts:
    """Return the counts of five nominal samples of 1 ms: states at `stamps` [ms], sent at once, commands at `answers`.

    An answer of -1 stands for none.
    """
    t, answered = (np.array([round(1e6 * each) if each >= 0 else -1 for each in given]) for given in (stamps, answers))
    bag, signals = Bag(Path(), {"/joint_states": Topic("", "", "", lost=lost)}, True), SimpleNamespace(stamp=t, sent=t)
    signals.answered = answered
    run = SimpleNamespace(signals=signals, sample_period=PERIOD, lockstep=False, bag=bag)
    return counts(run, duration)  # type: ignore[arg-type]


@pytest.mark.parametrize("late", [0.0, 0.3, 0.7, 0.99])
def test_a_run_has_never_more_states_than_nominal_because_its_first_was_late(late: float) -> None:
    stamps = [0.0, *(k - late for k in range(1, 5))]  # times count from the first state
    for count in (5, 6):
        t = [*stamps, 5 - late][:count]
        for duration in (5 * PERIOD, t[-1] * PERIOD + PERIOD):  # as planned, and up to the last state
            kept = [stamp for stamp in t if stamp * PERIOD < duration]
            counts = counted(kept, [stamp + 0.005 for stamp in kept], 0, duration)
            assert counts.published == counts.answered_in_time == counts.nominal == len(kept)
            assert (counts.missing, counts.gaps, counts.late, counts.unanswered) == (0, 0, 0, 0)
            assert counts.answered_in_time_fraction == 1.0


def test_missed_late_unanswered_and_lost_samples_are_counted() -> None:
    # 2 is skipped, 1 answered after 3, 3 unanswered
    counts = counted([0, 1, 3, 4], [0.3, 3.2, -1, 4.3], 7)
    assert (counts.published, counts.missing, counts.gaps) == (4, 1, 1)
    assert (counts.answered, counts.answered_in_time, counts.late, counts.unanswered) == (3, 2, 1, 1)
    assert counts.longest_gap_s == pytest.approx(2 * PERIOD)
    assert counts.published_fraction == pytest.approx(4 / 5)
    assert counts.answered_in_time_fraction == pytest.approx(2 / 4)
    assert counts.lost_by_recorder == {"/joint_states": 7}
