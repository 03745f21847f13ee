# SPDX-License-Identifier: Apache-2.0
"""Write the confusion table of docs/verdict.md anew, between its markers: every run of the labelled set as a bag.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.diagnosis_benchmark.table
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from fjr_core.monitoring.diagnosis import Verdict, judge

from .bags import read_record, write_bag
from .runs import DEGRADED, FOUND_ON, HOLDING, TRIED_ON, UNDECIDED, VIOLATED, Case, Label, cases, label, run

PAGE = Path(__file__).resolve().parents[2] / "docs" / "verdict.md"
BEGIN = "<!-- confusion: written by tools/diagnosis_benchmark/table.py -->"
END = "<!-- end of confusion -->"
NAMES = (HOLDING, "model mismatch", "saturation", "delay", "loss", "sampling")
OTHER = "several or none"


def judged(case: Case, folder: Path) -> tuple[Label, Verdict]:
    """The label of a case and the verdict on its bag, which is written into `folder`."""
    scenario, log = run(case)
    write_bag(log, scenario, folder)
    record = read_record(folder, scenario)
    return label(case, record), judge(record, scenario.tracking_law)


def said(verdict: Verdict) -> str:
    """Return the verdict in a word: "holding", its only cause, or what else it is."""
    if verdict.kind not in (DEGRADED, VIOLATED):
        return verdict.kind
    return verdict.causes[0] if len(verdict.causes) == 1 else OTHER


def table(pairs: Iterable[tuple[str, str]], rows: tuple[str, ...] = NAMES) -> list[str]:
    """Return labels down, verdicts across, as lines of Markdown."""
    counts = Counter(pairs)
    known = [name for name in rows if name != UNDECIDED]
    columns = (*known, *sorted({verdict for _, verdict in counts} - set(known)))
    lines = ["| label | " + " | ".join(columns) + " |", "| --- " * (len(columns) + 1) + "|"]
    for name in rows:
        cells = (str(counts[name, column] or "") for column in columns)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def confusion(seed: int) -> list[str]:
    """Return the tables of causes and of grades for the set of a seed; print to stderr what is not right."""
    causes, grades = [], []
    with tempfile.TemporaryDirectory(prefix="fjr-verdicts-") as folder:
        for i, case in enumerate(cases(seed)):
            wanted, verdict = judged(case, Path(folder, str(i)))
            causes.append((wanted.cause, said(verdict)))
            grades.append((wanted.grade, verdict.kind))
            if not right(wanted, verdict):
                print(f"seed {seed}: {case.name}: {wanted}, not {verdict.sentence}", file=sys.stderr)
    return [*table(causes), "", *table(grades, (HOLDING, DEGRADED, UNDECIDED, VIOLATED))]


def right(wanted: Label, verdict: Verdict) -> bool:
    """Return whether the verdict is the label."""
    graded = verdict.kind == wanted.grade or (wanted.grade == UNDECIDED and verdict.kind in (DEGRADED, VIOLATED))
    return graded and said(verdict) == wanted.cause


def main() -> int:
    """Rewrite the page."""
    words = {TRIED_ON: "Tried on", FOUND_ON: "The thresholds were found on"}
    parts = [["", f"{what} the set of seed {seed}:", "", *confusion(seed)] for seed, what in words.items()]
    lines = [line for part in parts for line in part]
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    PAGE.write_text("\n".join([before + BEGIN, *lines, "", END + after]), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
