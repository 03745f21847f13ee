# SPDX-License-Identifier: Apache-2.0
"""Inject all faults and regenerate the table of docs/tables/faults.md: `python -m tests.faults [WORD ...]`.

The workspace must be sourced. With words, only rows whose name contains one of them run, and the table is only printed.
"""

from __future__ import annotations

import math
import sys
from contextlib import closing
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(TESTS))

import conftest  # noqa: E402, F401 (a ROS domain of its own)
from bench.figures import markdown, put  # noqa: E402
from faults.fault_rows import ROWS, Row  # noqa: E402
from faults.outcome import Outcome, Pair  # noqa: E402

HEAD = ("fault", "what the arm does", "peak q_tilde_l [rad]", "recovered after [s]", "bad efforts")


def main(words: list[str]) -> int:
    """Return the exit code: 0 if no effort was bad."""
    rows = [row for row in ROWS if not words or any(word in row.name for word in words)]
    done: list[tuple[Row, Outcome]] = []
    for number, row in enumerate(rows, start=1):
        print(f"[{number}/{len(rows)}] {row.name}", file=sys.stderr, flush=True)
        with closing(Pair()) as pair:
            done.append((row, pair.outcome(row)))
    table = markdown(HEAD, [cells(row, seen) for row, seen in done], right=HEAD[2:])
    print(*table, sep="\n")
    if not words:
        put("faults.md", "faults", table)
    return 1 if any(seen.bad for _, seen in done) else 0


def cells(row: Row, seen: Outcome) -> tuple[str, ...]:
    """Return the cells of a row of the table."""
    recovery = "stays stopped" if math.isinf(seen.recovery) else f"{seen.recovery:.2f}" if seen.recovery else "0"
    return row.name, row.arm, f"{seen.peak:.2g}", recovery, f"{seen.bad} of {seen.efforts}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
