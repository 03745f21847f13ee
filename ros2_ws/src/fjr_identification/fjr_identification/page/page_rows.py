# SPDX-License-Identifier: Apache-2.0
"""Rows of the parameter table of the identification page, with each interval as a bar."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from fjr_design.uncertainty.posterior import IDENTIFIED, UNKNOWN, WEAK, Estimate, Identification
from fjr_msgs_py.console.formatting import DASH, interval, number

COLOURS = {IDENTIFIED: "ok", WEAK: "maybe", UNKNOWN: "no"}
WIDEST = 4.0  # factor between the value and each end of the axis of a positive parameter
BAR_HEAD = "interval, value, prior"


@dataclass(frozen=True)
class Row:
    """Texts of one estimate, and its bar in percent of the axis; prior_at: None if it is outside.

    reason: number of the reason of the verdict in `reasons`, from 1 on; None without one.
    """

    joint: str
    value: str
    interval: str
    prior: str
    verdict: str
    reason: int | None
    colour: str
    left: float
    width: float
    middle: float
    prior_at: float | None


def reasons(found: Identification) -> list[str]:
    """Return the reasons of all verdicts, each once, in the order of the estimates."""
    return list(dict.fromkeys(each.reason for each in found.estimates if each.reason))


def groups(found: Identification) -> list[tuple[str, list[Row]]]:
    """Return the rows by parameter, in the order of the estimates."""
    names, why = list(dict.fromkeys(each.name for each in found.estimates)), reasons(found)
    named = {name: [each for each in found.estimates if each.name == name] for name in names}
    return [(_title(name), list(_rows(estimates, why))) for name, estimates in named.items()]


def _title(name: str) -> str:
    words = name.replace("_", " ").replace("coulomb", "Coulomb")
    return words[:1].upper() + words[1:]


def _rows(estimates: Sequence[Estimate], why: Sequence[str]) -> Iterator[Row]:
    """Yield the rows of one parameter; all bars have one axis."""
    logarithmic = all(each.low > 0 for each in estimates)
    largest = max((abs(end) for each in estimates for end in (each.low, each.high, each.prior)), default=1.0) or 1.0
    for each in estimates:
        ends = [each.low, each.value, each.high, each.prior]
        places = [_ratio_place(end, each.value) if logarithmic else _place(end, largest) for end in ends]
        left, middle, right, prior = (round(min(100.0, max(0.0, place)), 2) for place in places)
        inside = 0.0 <= places[3] <= 100.0
        known = each.verdict != UNKNOWN
        yield Row(
            each.joint or "arm",
            number(each.value, each.unit),
            interval(each.low, each.high) if known else DASH,
            number(each.prior),
            each.verdict,
            why.index(each.reason) + 1 if each.reason else None,
            COLOURS[each.verdict],
            left if known else 0.0,
            round(right - left, 2) if known else 0.0,
            middle,
            prior if inside else None,
        )


def _ratio_place(value: float, middle: float) -> float:
    """Return the place in percent on a logarithmic axis around a value; -1 for a value that has none."""
    return 50.0 * (1.0 + math.log(value / middle) / math.log(WIDEST)) if value > 0 and middle > 0 else -1.0


def _place(value: float, largest: float) -> float:
    """Return the place in percent on a linear axis from -largest to largest."""
    return 50.0 * (1.0 + 0.95 * value / largest)
