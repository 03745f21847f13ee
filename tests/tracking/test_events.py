# SPDX-License-Identifier: Apache-2.0
"""Names of counters, events and states stand in the order of the enumerations of the control step."""

from __future__ import annotations

import re

from fjr_core.runtime.events import KINDS, STATES
from tracking.tracked import tracker_at


def enumerators(name: str) -> list[str]:
    """Return the names of an enumeration of step.h in order, in lower case and without prefix."""
    elements = tracker_at().ffi.typeof(f"enum {name}").elements
    return [elements[k].removeprefix("FJR_").lower() for k in range(len(elements))]


def test_kinds_have_the_order_of_the_counters() -> None:
    *counters, number = enumerators("fjr_kind")
    assert number == "kinds"
    assert len(counters) == len(KINDS)
    for counter, kind in zip(counters, KINDS, strict=True):
        assert set(counter.split("_")) <= set(re.findall(r"\w+", kind)), (counter, kind)


def test_states_have_the_order_of_the_enumeration() -> None:
    assert enumerators("fjr_state") == [state.value for state in STATES]
