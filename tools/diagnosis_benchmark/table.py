# SPDX-License-Identifier: Apache-2.0
"""Diagnose every labelled run from its bag and regenerate the confusion tables of docs/tables/diagnosis.md.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.diagnosis_benchmark.table
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from bench.figures import put
from fjr_monitor.diagnosis.diagnosis import Diagnosis, diagnose

from .bags import read_record, write_bag
from .runs import DEGRADED, HOLDING, TUNING_SEED, UNDECIDED, VALIDATION_SEED, VIOLATED, Case, Label, cases, label, run

PAGE = "diagnosis.md"
BEGIN = "<!-- confusion: written by tools/diagnosis_benchmark/table.py -->"
END = "<!-- end of confusion -->"
NAMES = (HOLDING, "model mismatch", "saturation", "delay", "loss", "sampling")
OTHER = "several or none"


def diagnosed(case: Case, folder: Path) -> tuple[Label, Diagnosis]:
    """Write the bag of a case into `folder` and return the label and the diagnosis of the bag."""
    scenario, log = run(case)
    write_bag(log, scenario, folder)
    record = read_record(folder, scenario)
    return label(case, record), diagnose(record, scenario.tracking_law)


def diagnosed_cause(verdict: Diagnosis) -> str:
    """Return the diagnosis as one word: its only cause, OTHER for several causes or none, else its kind."""
    if verdict.kind not in (DEGRADED, VIOLATED):
        return verdict.kind
    return verdict.causes[0] if len(verdict.causes) == 1 else OTHER


def table(pairs: Iterable[tuple[str, str]], rows: tuple[str, ...] = NAMES) -> list[str]:
    """Return Markdown lines: a row a label, a column a diagnosis."""
    counts = Counter(pairs)
    known = [name for name in rows if name != UNDECIDED]
    columns = (*known, *sorted({verdict for _, verdict in counts} - set(known)))
    lines = ["| label | " + " | ".join(columns) + " |", "| --- " * (len(columns) + 1) + "|"]
    for name in rows:
        cells = (str(counts[name, column] or "") for column in columns)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def confusion(seed: int) -> list[str]:
    """Return the tables of causes and of grades of the set of a seed; print each wrong diagnosis to stderr."""
    causes, grades = [], []
    with tempfile.TemporaryDirectory(prefix="fjr-diagnoses-") as folder:
        for i, case in enumerate(cases(seed)):
            wanted, verdict = diagnosed(case, Path(folder, str(i)))
            causes.append((wanted.cause, diagnosed_cause(verdict)))
            grades.append((wanted.grade, verdict.kind))
            if not right(wanted, verdict):
                print(f"seed {seed}: {case.name}: {wanted}, not {verdict.sentence}", file=sys.stderr)
    return [*table(causes), "", *table(grades, (HOLDING, DEGRADED, UNDECIDED, VIOLATED))]


def right(wanted: Label, verdict: Diagnosis) -> bool:
    """Return whether the diagnosis agrees with the label."""
    graded = verdict.kind == wanted.grade or (wanted.grade == UNDECIDED and verdict.kind in (DEGRADED, VIOLATED))
    return graded and diagnosed_cause(verdict) == wanted.cause


def main() -> int:
    """Rewrite the tables on the page."""
    headings = {VALIDATION_SEED: "Validation set", TUNING_SEED: "Set on which the thresholds were tuned"}
    parts = [["", f"{heading} (seed {seed}):", "", *confusion(seed)] for seed, heading in headings.items()]
    lines = [line for part in parts for line in part]
    put([*lines, ""], PAGE, BEGIN, END)
    return 0


if __name__ == "__main__":
    sys.exit(main())
