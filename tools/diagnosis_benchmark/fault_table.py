# SPDX-License-Identifier: Apache-2.0
"""Simulate every labelled fault and regenerate the confusion table of docs/tables/diagnosis.md.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.diagnosis_benchmark.fault_table        # about 10 min for a seed
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from bench.figures import put
from fjr_core.config.controller import axes
from fjr_monitor.diagnosis.diagnosis import diagnose

from .fault_runs import FAULTS, HEALTHY, VALIDATION_SEED, WIRING, FaultCase, cases

PAGE = "diagnosis.md"
BEGIN = "<!-- confusion: written by tools/diagnosis_benchmark/fault_table.py -->"
END = "<!-- end of confusion -->"
KINDS = (*FAULTS, *WIRING, HEALTHY)
SHORT = {kind: chr(ord("a") + i) for i, kind in enumerate(KINDS)}


@dataclass(frozen=True)
class Outcome:
    """Injected and diagnosed kind of fault of a run, and whether the joint is right."""

    kind: str
    found: str
    joint: bool


def outcome(case: FaultCase) -> Outcome:
    """Simulate a case and compare the first finding with the label."""
    scenario, _, found = case.run()
    joints = axes(scenario.controller_values, scenario.robot)
    findings = diagnose(found, scenario.tracking_law, axes=joints).findings
    if not findings:
        return Outcome(case.kind, HEALTHY, case.kind == HEALTHY)
    first = findings[0]
    return Outcome(case.kind, first.kind, first.joint == case.joints)


def table(outcomes: Iterable[Outcome]) -> list[str]:
    """Return Markdown lines: a row a label, a column a finding, last the count of right joints."""
    listed = list(outcomes)
    counts = Counter((each.kind, each.found) for each in listed)
    others = sorted({each.found for each in listed} - set(KINDS))
    columns = [*KINDS, *others]
    head = [*(SHORT.get(kind, kind) for kind in columns), "joint right"]
    lines = ["| label | " + " | ".join(head) + " |", "| --- " * (len(head) + 1) + "|"]
    for kind in KINDS:
        mine = [each for each in listed if each.kind == kind]
        cells = [str(counts[kind, found] or "") for found in columns]
        right = f"{sum(each.joint for each in mine)}/{len(mine)}"
        lines.append(f"| {SHORT[kind]} {kind} | " + " | ".join([*cells, right]) + " |")
    return lines


def shares(outcomes: Iterable[Outcome]) -> tuple[float, float]:
    """Return the shares of faulty runs with the right kind and with the right joint."""
    faulty = [each for each in outcomes if each.kind != HEALTHY]
    kinds, joints = (sum(e.kind == e.found for e in faulty), sum(e.joint for e in faulty))
    return kinds / len(faulty), joints / len(faulty)


def confusion(seed: int) -> list[str]:
    """Return the table of the set of a seed; print each wrong finding to stderr."""
    outcomes = []
    for case in cases(seed):
        outcomes.append(result := outcome(case))
        if result.kind != result.found or not result.joint:
            print(f"seed {seed}: {case.name}: {result}", file=sys.stderr, flush=True)
    kind, joint = shares(outcomes)
    faulty = sum(each.kind != HEALTHY for each in outcomes)
    return [
        f"{faulty} faulty runs: kind right in {100 * kind:.1f} %, joint in {100 * joint:.1f} %.",
        "",
        *table(outcomes),
    ]


def main() -> int:
    """Rewrite the table on the page."""
    lines = ["", f"Validation set (seed {VALIDATION_SEED}):", "", *confusion(VALIDATION_SEED)]
    put([*lines, ""], PAGE, BEGIN, END)
    return 0


if __name__ == "__main__":
    sys.exit(main())
