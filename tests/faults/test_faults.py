# SPDX-License-Identifier: Apache-2.0
"""Each fault of docs/tables/faults.md, injected into real processes in motion, measured by an independent watcher."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest

from faults.fault_rows import ROWS, Row
from faults.outcome import Pair
from faults.rig import STEPPED

pytestmark = pytest.mark.system
EXECUTORS = ("native", "events")
"""Executors of both nodes; `make test` tries the first with each fault once, `make test-all` all rows with both."""


@pytest.fixture(scope="module")
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    """The nodes that all rows of one executor, setting and mode disturb."""
    made = Pair(request.param[0])
    yield made
    made.close()


def cases() -> Iterator[Any]:
    """Return the rows by executor, mode and setting; those in lock-step need no clock, so others may run meanwhile."""
    for executor in EXECUTORS:
        for row in sorted(ROWS, key=lambda row: (row.mode, row.setting.scenario)):
            marks = [] if row.mode == STEPPED else [pytest.mark.real_time]
            marks += [pytest.mark.full] if row.another or executor != EXECUTORS[0] else []
            name = row.name if executor == EXECUTORS[0] else f"{row.name}, {executor}"
            yield pytest.param((executor, row.mode, row.setting.scenario), row, id=name, marks=marks)


# Without the scope pytest would make a pair for each row, because `row` is not a fixture.
@pytest.mark.parametrize(("pair", "row"), list(cases()), indirect=["pair"], scope="module")
def test_fault_causes_no_bad_effort_and_tracking_recovers(pair: Pair, row: Row) -> None:
    seen = pair.outcome(row)
    assert seen.bad == 0, f"{seen.bad} of {seen.efforts} efforts are not finite or over the limit"
    assert all(seen.counters[kind] for kind in row.counted), dict(seen.counters)
    assert seen.peak <= row.peak
    expected = math.inf if row.recovery is None else row.recovery
    assert seen.recovery <= expected
    if row.recovery is None:
        assert seen.recovery == math.inf
