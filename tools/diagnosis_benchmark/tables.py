# SPDX-License-Identifier: Apache-2.0
"""Diagnose every labelled run and every labelled fault; regenerate the confusion tables of docs/tables/diagnosis.md.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.diagnosis_benchmark.tables causes faults     # faults: 10 min

Runs are diagnosed from their bags, faults from their records. Each wrong diagnosis is printed to stderr.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.figures import markdown, put
from fjr_monitor.diagnosis.diagnosis import diagnose
from fjr_monitor.diagnosis.thresholds import JointTolerances
from fjr_monitor.diagnosis.verdict import Diagnosis

from . import cases, faults
from .bags import read_record, write_bag
from .cases import DEGRADED, HOLDING, UNDECIDED, VIOLATED, Case, Label
from .faults import FAULTS, HEALTHY, WIRING, duration_of, joints_of

NAMES = (HOLDING, "model mismatch", "saturation", "delay", "loss", "sampling")
OTHER = "several or none"
KINDS = (*FAULTS, *WIRING, HEALTHY)
SHORT = {kind: chr(ord("a") + i) for i, kind in enumerate(KINDS)}


def begin(table: str) -> str:
    """Return the line before the tables of `causes` or `faults` on the page."""
    return f"<!-- {table}: written by tools/diagnosis_benchmark/tables.py -->"


def diagnosed(case: Case, folder: Path) -> tuple[Label, Diagnosis]:
    """Write the bag of a case into `folder` and return the label and the diagnosis of the bag."""
    loop = case.run()
    write_bag(loop, folder)
    record = read_record(folder, loop.scenario)
    return cases.label(case, record), diagnose(record, loop.scenario.tracking_law)


def diagnosed_cause(verdict: Diagnosis) -> str:
    """Return the diagnosis as one word: its only cause, OTHER for several causes or none, else its kind."""
    if verdict.kind not in (DEGRADED, VIOLATED):
        return verdict.kind
    return verdict.causes[0] if len(verdict.causes) == 1 else OTHER


def right(wanted: Label, verdict: Diagnosis) -> bool:
    """Return whether the diagnosis agrees with the label."""
    graded = verdict.kind == wanted.grade or (wanted.grade == UNDECIDED and verdict.kind in (DEGRADED, VIOLATED))
    return graded and diagnosed_cause(verdict) == wanted.cause


def table(pairs: Iterable[tuple[str, str]], rows: tuple[str, ...] = NAMES) -> list[str]:
    """Return Markdown lines: a row a label, a column a diagnosis."""
    counts = Counter(pairs)
    known = [name for name in rows if name != UNDECIDED]
    columns = (*known, *sorted({verdict for _, verdict in counts} - set(known)))
    return markdown(
        ("label", *columns), [(name, *(str(counts[name, column] or "") for column in columns)) for name in rows]
    )


def causes_of(seed: int) -> list[str]:
    """Return the tables of causes and of grades of the set of a seed."""
    causes, grades = [], []
    with tempfile.TemporaryDirectory(prefix="fjr-diagnoses-") as folder:
        for i, case in enumerate(cases.cases(seed)):
            wanted, verdict = diagnosed(case, Path(folder, str(i)))
            causes.append((wanted.cause, diagnosed_cause(verdict)))
            grades.append((wanted.grade, verdict.kind))
            if not right(wanted, verdict):
                print(f"seed {seed}: {case.name}: {wanted}, not {verdict.sentence}", file=sys.stderr)
    return [*table(causes), "", *table(grades, (HOLDING, DEGRADED, UNDECIDED, VIOLATED))]


@dataclass(frozen=True)
class Outcome:
    """Injected and diagnosed kind of fault of a run, and whether the joint is right."""

    kind: str
    found: str
    joint: bool


def outcome(case: Case) -> Outcome:
    """Simulate a fault and compare the first finding with the label."""
    loop = case.run(duration_of(case))
    axes = JointTolerances.of(loop.scenario.controller_values, loop.scenario.robot)
    findings = diagnose(loop.record(), loop.scenario.tracking_law, axes=axes).findings
    if not findings:
        return Outcome(case.kind, HEALTHY, case.kind == HEALTHY)
    return Outcome(case.kind, findings[0].kind, findings[0].joint == joints_of(case))


def fault_table(outcomes: Sequence[Outcome]) -> list[str]:
    """Return Markdown lines: a row a label, a column a finding, last the count of right joints."""
    counts = Counter((each.kind, each.found) for each in outcomes)
    columns = [*KINDS, *sorted({each.found for each in outcomes} - set(KINDS))]
    rows = []
    for kind in KINDS:
        joints = [each.joint for each in outcomes if each.kind == kind]
        cells = (str(counts[kind, found] or "") for found in columns)
        rows.append((f"{SHORT[kind]} {kind}", *cells, f"{sum(joints)}/{len(joints)}"))
    return markdown(("label", *(SHORT.get(kind, kind) for kind in columns), "joint right"), rows)


def shares(outcomes: Iterable[Outcome]) -> tuple[float, float]:
    """Return the shares of faulty runs with the right kind and with the right joint."""
    faulty = [each for each in outcomes if each.kind != HEALTHY]
    kinds, joints = (sum(e.kind == e.found for e in faulty), sum(e.joint for e in faulty))
    return kinds / len(faulty), joints / len(faulty)


def faults_of(seed: int) -> list[str]:
    """Return the table of the set of a seed, below the shares of right findings."""
    outcomes = []
    for case in faults.cases(seed):
        outcomes.append(result := outcome(case))
        if result.kind != result.found or not result.joint:
            print(f"seed {seed}: {case.name}: {result}", file=sys.stderr, flush=True)
    kind, joint = shares(outcomes)
    faulty = sum(each.kind != HEALTHY for each in outcomes)
    said = f"{faulty} faulty runs: kind right in {100 * kind:.1f} %, joint in {100 * joint:.1f} %."
    return [said, "", *fault_table(outcomes)]


TABLES = {
    "causes": (
        causes_of,
        {"Validation set": cases.VALIDATION_SEED, "Set on which the thresholds were tuned": cases.TUNING_SEED},
    ),
    "faults": (faults_of, {"Validation set": faults.VALIDATION_SEED}),
}


def main() -> None:
    """Rewrite the named tables on the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="+", choices=TABLES)
    for name in parser.parse_args().tables:
        confusion, seeds = TABLES[name]
        parts = [["", f"{heading} (seed {seed}):", "", *confusion(seed)] for heading, seed in seeds.items()]
        put([*(line for part in parts for line in part), ""], "diagnosis.md", begin(name), f"<!-- end of {name} -->")


if __name__ == "__main__":
    main()
