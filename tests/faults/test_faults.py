# SPDX-License-Identifier: Apache-2.0
"""Each fault of docs/faults.md, injected into real processes in full motion and measured by an independent watcher."""

from __future__ import annotations

import math

import pytest

from faults.outcome import outcome
from faults.rows import ROWS, Row

pytestmark = [pytest.mark.system, pytest.mark.real_time]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_fault_causes_no_bad_effort_and_tracking_recovers(row: Row) -> None:
    seen = outcome(row)
    assert seen.bad == 0, f"{seen.bad} of {seen.efforts} efforts are not finite or over the limit"
    assert all(seen.counters[kind] for kind in row.counted), dict(seen.counters)
    assert seen.peak <= row.peak
    expected = math.inf if row.recovery is None else row.recovery
    assert seen.recovery <= expected
    if row.recovery is None:
        assert seen.recovery == math.inf
