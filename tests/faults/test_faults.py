# SPDX-License-Identifier: Apache-2.0
"""Each row of docs/faults.md: real processes, disturbed in full motion, judged by an independent watcher."""

from __future__ import annotations

import math

import pytest

from faults.outcome import TRIES, Outcome, outcome
from faults.rig import STEPPED
from faults.rows import ROWS, Row

pytestmark = [pytest.mark.system, pytest.mark.real_time]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_a_fault_is_survived(row: Row) -> None:
    """In real time on a noisy machine a row may be tried again, but no effort may ever be bad."""
    for left in reversed(range(1 if row.mode == STEPPED else TRIES)):
        try:
            seen = outcome(row)
        except AssertionError:
            if not left:
                raise
            continue
        assert seen.bad == 0, f"{seen.bad} of {seen.efforts} efforts are not finite or over the limit"
        trouble = _trouble(row, seen)
        if not trouble:
            return
    pytest.fail(trouble)


def _trouble(row: Row, seen: Outcome) -> str:
    """What is not as the row has it, empty for nothing."""
    missing = [kind for kind in row.counted if not seen.counters[kind]]
    if missing:
        return f"counted were {dict(seen.counters)}; expected {missing} among them"
    if seen.peak > row.peak:
        return f"the peak is {seen.peak:.3g} rad; expected at most {row.peak:.3g}"
    expected = math.inf if row.recovery is None else row.recovery
    if seen.recovery > expected or (row.recovery is None and seen.recovery < math.inf):
        return f"recovered after {seen.recovery:.3g} s; expected {expected:.3g} s"
    return ""
