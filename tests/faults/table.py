# SPDX-License-Identifier: Apache-2.0
"""Format the table of docs/tables/faults.md between its markers."""

from __future__ import annotations

import math
from collections.abc import Iterable

from faults.fault_rows import Row
from faults.outcome import Outcome

BEGIN = "<!-- faults: written by python -m tests.faults -->"
END = "<!-- end of faults -->"
HEAD = (
    "| fault | what the arm does | peak q_tilde_l [rad] | recovered after [s] | bad efforts |\n"
    "| --- | --- | ---: | ---: | ---: |"
)


def table(done: Iterable[tuple[Row, Outcome]]) -> str:
    """Return the table as Markdown, one line a row."""
    return "\n".join([HEAD, *(_line(row, seen) for row, seen in done)])


def written(document: str, text: str) -> str:
    """Return the document with `text` between its markers."""
    before, rest = document.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}\n{text}\n{END}{after}"


def _line(row: Row, seen: Outcome) -> str:
    figures = f"{seen.peak:.2g} | {_recovery(seen)} | {seen.bad} of {seen.efforts}"
    return f"| {row.name} | {row.arm} | {figures} |"


def _recovery(seen: Outcome) -> str:
    if math.isinf(seen.recovery):
        return "stays stopped"
    return "0" if seen.recovery == 0 else f"{seen.recovery:.2f}"
