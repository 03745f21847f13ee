# SPDX-License-Identifier: Apache-2.0
"""The certificate of the control step equals that along a run, with machine code of the law and without."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.monitoring.certificate import Certificate
from fjr_core.runtime.library import step_library
from fjr_monitor.diagnosis.diagnosis import innovations
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.diagnosis.thresholds import LONGEST_JUDGED
from monitor.diagnosis.loops import Certified

MS = 1_000_000  # ns
ROBOT = fjr.planar_two_link()
GAINS = fjr.Gains(16.0, [30.0, 4.0], [1.7, 0.22], 16.0, [40.0, 25.0], [0.32, 0.16])
LAW = fjr.TrackingLaw(ROBOT, GAINS)
RNG = np.random.default_rng(3)
POSITION, VELOCITY, JETS, U = (RNG.uniform(-1, 1, shape) for shape in ((9, 4), (9, 4), (9, 5, 2), (9, 2)))
VALUES = ("V", "dV", "H", "supplied", "dissipated")


def taken(law: fjr.TrackingLaw) -> tuple[Certified, np.ndarray]:
    """Take the states above, 1 ms apart; return the certificate and the values of each."""
    online, rows = Certified(law), []
    for k in range(len(U)):
        found = online.take((k + 5) * MS, POSITION[k], VELOCITY[k], JETS[k], U[k])
        rows.append([getattr(found, name) for name in VALUES])
    return online, np.array(rows)


def test_values_and_innovations_equal_those_along_the_run() -> None:
    online, rows = taken(LAW)
    series = Certificate(LAW).along(POSITION, VELOCITY, JETS, U)
    assert rows == pytest.approx(np.stack([getattr(series, name) for name in VALUES], axis=1), rel=1e-12)
    t = np.arange(len(U)) * 1e-3
    record = Record(t, POSITION, VELOCITY, JETS, U, None, None, None, 1e-3, np.full(2, np.inf))
    expected, found = innovations(record, LAW), online.last(100)
    for name in ("dt", "V0", "V1", "predicted", "sent", "law", "older", "error", "slope", "tracking"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-9, abs=1e-12), name


def test_machine_code_and_evaluation_in_python_agree_to_rounding() -> None:
    here, there = taken(LAW)[1], taken(fjr.TrackingLaw(ROBOT, GAINS, compile=True))[1]
    np.testing.assert_allclose(here, there, rtol=0, atol=1e-12 * np.abs(there).max())


@pytest.mark.parametrize(
    "break_", [{"restarted": True}, {"stamp": 5 * MS}, {"stamp": 6 * MS + round(LONGEST_JUDGED * 1e9)}]
)
def test_state_after_a_break_or_a_value_that_is_not_finite_follows_no_other(break_: dict[str, Any]) -> None:
    online, state = Certified(LAW), (POSITION[0], VELOCITY[0], JETS[0], U[0])
    assert not online.certify(5 * MS, *state).follows
    assert online.certify(6 * MS, *state).valid
    assert not online.certify(break_.pop("stamp", 7 * MS), *state, **break_).follows
    online.restart()
    assert not online.certify(8 * MS, *state).follows
    online.certify(9 * MS, *state)  # a value that is not finite is not valid and has no successor
    assert not online.certify(10 * MS, POSITION[0], VELOCITY[0] * np.inf, JETS[0], U[0]).valid
    assert not online.certify(11 * MS, *state).follows


def test_bound_decays_from_V_at_its_first_sample_and_there_is_none_without_it() -> None:
    online, state = Certified(LAW), (POSITION[0], VELOCITY[0], JETS[0], U[0])
    online.struct.pointer.beta = 10.0
    first = online.certify(5 * MS, *state, bound_start=5 * MS).V
    assert online.certify(8 * MS, *state, bound_start=5 * MS).bound == pytest.approx(
        first * np.exp(-2 * 10.0 * 3e-3), rel=1e-12
    )
    assert online.certify(9 * MS, *state).bound == -1
    assert online.certify(10 * MS, *state, bound_start=10 * MS).bound == first
    online.struct.pointer.bounded = False
    assert online.certify(11 * MS, *state, bound_start=10 * MS).bound == -1


def test_messages_for_observers_are_due_on_a_grid_that_a_jump_restarts() -> None:
    library = step_library(1)
    rate = library.ffi.new("struct fjr_auxiliary_rate *", (10 * MS, 0))

    def due(stamps: list[int]) -> list[int]:
        return [stamp for stamp in stamps if library.lib.fjr_is_due(rate, stamp * MS)]

    assert due(list(range(100, 131))) == [100, 110, 120, 130]
    assert due([137, 143, 144, 151]) == [143, 151]  # 140 and 150 are missing
    assert due([500, 505, 510]) == [500, 510]
    assert due([3, 12, 13]) == [3, 13]
    assert due([33, 34, 43]) == [33, 43]  # one period late
    rate.period = 1
    assert due([50, 50, 51]) == [50, 51]
    rate.period = 0
    assert due([14, 15]) == [14, 15]
