# SPDX-License-Identifier: Apache-2.0
"""Diagnose every labelled run and every labelled fault; regenerate the tables of docs/tables/diagnosis.md.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.diagnosis_benchmark.tables causes faults rubbing wiring alarms

Runs are diagnosed from their bags, faults from their records. Each wrong diagnosis is printed to stderr. `foreign`
takes 6 minutes. Its results are kept in RESULTS: a later call takes up where an earlier one ended, and several
processes, each in an order of its own, share the work.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.figures import ROOT, kept, markdown, put
from fjr_monitor.diagnosis.diagnosis import diagnose
from fjr_monitor.diagnosis.hypotheses import FRICTIONS
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.diagnosis.thresholds import JointTolerances
from fjr_monitor.diagnosis.torque_faults import UNKNOWN
from fjr_monitor.diagnosis.verdict import Diagnosis

from . import cases, faults
from .cases import DEGRADED, HOLDING, SETTLED, UNDECIDED, VIOLATED, Case, Label, nominal
from .faults import FAULTS, FOREIGN, FOREIGN_COUNT, HEALTHY, ROBOTS, WIRING, duration_of, foreign, joints_of
from .lock_step import read_record, write_bag
from .wiring import HEALTHY_LASTING, LASTING, SEEDS, SENSORS, Stop, healthy, with_sensors, wrong

NAMES = (HOLDING, "model mismatch", "saturation", "delay", "loss", "sampling")
RESULTS = ROOT / "runs" / "foreign"
STARTS = 60  # of each robot and kind of noise
OF_RUBBING = "kind and joint named", "joint named", "friction alone", "nothing", "a healthy joint named"
OTHER, SEVERAL = "several or none", "several"
KINDS = (*FAULTS, *WIRING, HEALTHY)
SHORT = {kind: chr(ord("a") + i) for i, kind in enumerate(KINDS)}


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


def counted(pairs: Iterable[tuple[str, str]], rows: Sequence[str]) -> tuple[list[str], list[list[str]]]:
    """Return the columns, which are the rows and whatever else was found, and the counts of each row."""
    counts = Counter(pairs)
    known = [name for name in rows if name != UNDECIDED]
    columns = [*known, *sorted({found for _, found in counts} - set(known))]
    return columns, [[str(counts[name, column] or "") for column in columns] for name in rows]


def table(pairs: Iterable[tuple[str, str]], rows: Sequence[str] = NAMES) -> list[str]:
    """Return Markdown lines: a row a label, a column a diagnosis."""
    columns, cells = counted(pairs, rows)
    return markdown(("label", *columns), [(name, *row) for name, row in zip(rows, cells, strict=True)])


def causes_of(heading: str, seed: int) -> list[str]:
    """Return the tables of causes and of grades of the set of a seed, below a heading."""
    causes, grades = [], []
    with tempfile.TemporaryDirectory(prefix="fjr-diagnoses-") as folder:
        for i, case in enumerate(cases.cases(seed)):
            wanted, verdict = diagnosed(case, Path(folder, str(i)))
            causes.append((wanted.cause, diagnosed_cause(verdict)))
            grades.append((wanted.grade, verdict.kind))
            if not right(wanted, verdict):
                print(f"seed {seed}: {case.name}: {wanted}, not {verdict.sentence}", file=sys.stderr)
    of_grades = table(grades, (HOLDING, DEGRADED, UNDECIDED, VIOLATED))
    return [f"{heading} (seed {seed}):", "", *table(causes), "", *of_grades]


class Outcome(NamedTuple):
    """Injected and diagnosed kind of fault of a run, and whether the joint is right."""

    kind: str
    found: str
    joint: bool


def diagnosed_fault(case: Case) -> tuple[Record, JointTolerances, Diagnosis]:
    """Simulate a fault; return the record, what its robot tolerates, and the diagnosis."""
    loop = case.run(duration_of(case))
    record, axes = loop.record(), JointTolerances.of(loop.scenario.controller_values, loop.scenario.robot)
    return record, axes, diagnose(record, loop.scenario.tracking_law, axes=axes)


def outcome(case: Case) -> Outcome:
    """Simulate a fault and compare the first finding with the label."""
    *_, said = diagnosed_fault(case)
    if not said.findings:
        return Outcome(case.kind, HEALTHY, case.kind == HEALTHY)
    return Outcome(case.kind, said.findings[0].kind, said.findings[0].joint == joints_of(case))


def faults_table() -> list[str]:
    """Return the table of the validation set, with the count of right joints, below the shares of right findings."""
    outcomes, seed = [], faults.VALIDATION_SEED
    for case in faults.cases(seed):
        outcomes.append(result := outcome(case))
        if result.kind != result.found or not result.joint:
            print(f"seed {seed}: {case.name}: {result}", file=sys.stderr, flush=True)
    columns, cells = counted([(e.kind, SEVERAL if " or " in e.found else e.found) for e in outcomes], KINDS)
    joints = {kind: [each.joint for each in outcomes if each.kind == kind] for kind in KINDS}
    rows = [
        (f"{SHORT[kind]} {kind}", *row, f"{sum(joints[kind])}/{len(joints[kind])}")
        for kind, row in zip(KINDS, cells, strict=True)
    ]
    faulty = [each for each in outcomes if each.kind != HEALTHY]
    right = [(e.kind == e.found, e.kind in e.found.split(" or "), e.joint) for e in faulty]
    alone, named, joint = 100 * np.mean(right, axis=0)
    kinds = f"kind right in {alone:.1f} % alone, in {named:.1f} % alone or beside others"
    said = f"{len(faulty)} faulty runs: {kinds}, joint in {joint:.1f} %."
    head = "label", *(SHORT.get(each, each) for each in columns), "joint right"
    return [f"Validation set (seed {seed}):", "", said, "", *markdown(head, rows)]


def rubbing_table() -> list[str]:
    """Return what is said of faults in arms whose motors rub, a row for each kind."""
    counts = Counter((case.kind, said_of_rubbing(case)) for case in faults.rubbing())
    kinds = list(dict.fromkeys(kind for kind, _ in counts))
    rows = [(kind, *(str(counts[kind, said] or "") for said in OF_RUBBING)) for kind in kinds]
    return markdown(("fault", *OF_RUBBING), rows)


def said_of_rubbing(case: Case) -> str:
    """Simulate a fault in an arm that rubs; return what the findings beside friction name."""
    *_, said = diagnosed_fault(case)
    others = [each for each in said.findings if each.kind not in FRICTIONS]
    if any(each.joint not in ("", joints_of(case)) for each in others):
        print(f"{case.name}: {said.sentence}", file=sys.stderr, flush=True)
        return OF_RUBBING[4]
    if any(case.kind in each.kind.split(" or ") for each in others):
        return OF_RUBBING[0]
    if any(each.joint for each in others):
        return OF_RUBBING[1]
    return OF_RUBBING[2] if said.findings and said.findings[0].kind in FRICTIONS else OF_RUBBING[3]


def wiring() -> list[str]:
    """Return the table of how fast each fault is found; print which of 200 healthy starts of a robot are stopped."""
    rows = []
    for scenario in ROBOTS:
        for kind in WIRING:
            if stops := [Stop.of(case, LASTING) for seed in SEEDS for case in wrong(scenario, kind, seed)]:
                samples, travel, effort = np.array([(each.samples, each.travel, each.effort) for each in stops]).T
                median, most = np.sort(samples)[[len(samples) // 2, -1]]
                found = len(stops), f"{median:.0f}", f"{most:.0f}", f"{travel.max():.3f}", f"{effort.max():.0f}"
                rows.append((scenario, kind, *map(str, found)))
        stopped = [each for each in range(200) if Stop.of(healthy(scenario, each), HEALTHY_LASTING).samples]
        print(f"{scenario}: 200 healthy starts, stopped by the wiring: {stopped}", file=sys.stderr, flush=True)
    head = ("robot", "fault", "runs", "samples: median", "largest", "travel until the stop [rad]", "peak effort [N m]")
    return markdown(head, rows)


def alarms() -> list[str]:
    """Return how many of STARTS healthy starts with other sensors the check of the wiring stops."""
    rows = []
    for noise in SENSORS:
        stopped = [
            sum(Stop.of(with_sensors(scenario, noise, seed), HEALTHY_LASTING).samples > 0 for seed in range(STARTS))
            for scenario in ("two_link", "arm7")
        ]
        rows.append((noise, *map(str, stopped)))
    return markdown(("noise, 1 µrad to 1 mrad", "`two_link` stopped", "`arm7` stopped"), rows)


def foreign_result(number: int) -> dict[str, Any]:
    """Return what the diagnosis says of a run of FOREIGN, and its largest settled error relative to the tolerance."""
    case = foreign(number)
    record, axes, said = diagnosed_fault(case)
    error = np.abs(record.position[:, : case.n] - record.jets[:, 0])[record.t > 2 * SETTLED]
    first = said.findings[0] if said.findings else None
    return {
        "name": case.name,
        "kind": case.kind,
        "joint": nominal(case.scenario).joints[case.joint],
        "verdict": said.kind,
        "found": first.kind if first else "",
        "at": first.joint if first else "",
        "error": float((error / axes.tolerance).max(initial=0.0)),
    }


def foreign_table() -> list[str]:
    """Return the table of the faults that the sets lack, with a row for each kind and one for all."""
    files = {number: RESULTS / f"{number:04d}.json" for number in range(FOREIGN_COUNT)}
    order = np.random.default_rng(os.getpid()).permutation(FOREIGN_COUNT).tolist()
    results = [kept(files[number], partial(foreign_result, number)) for number in order]
    found: list[tuple[str, ...]] = []
    for kind in (*FOREIGN, "all"):
        own = [each for each in results if kind in ("all", each["kind"])]
        named = [each for each in own if each["at"] and each["found"] != UNKNOWN and " or " not in each["found"]]
        right = [each["found"] in FOREIGN[each["kind"]][1] and each["at"] == each["joint"] for each in named]
        located = [each for each in own if FOREIGN[each["kind"]][0] != ("",)]
        joints = sum(each["at"] == each["joint"] for each in located)
        wrongly = sum(each["verdict"] == "holding" and each["error"] > 1 for each in own)
        held = sum(each["verdict"] == "holding" for each in own)
        counts = f"{sum(right)} of {len(named)}", f"{joints} of {len(located)}"
        found.append((kind, str(len(own)), *counts, str(held), str(wrongly)))
    right_kind, beyond = "one kind and joint named: right", "of these beyond the tolerance"
    return markdown(("fault", "runs", right_kind, "joint right", "holding", beyond), found)


TABLES: dict[str, Callable[[], list[str]]] = {
    "causes": lambda: [
        *causes_of("Validation set", cases.VALIDATION_SEED),
        "",
        *causes_of("Set on which the thresholds were tuned", cases.TUNING_SEED),
    ],
    "faults": faults_table,
    "rubbing": rubbing_table,
    "wiring": wiring,
    "alarms": alarms,
    "foreign": foreign_table,
}


def main() -> None:
    """Rewrite the named tables on the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="+", choices=TABLES)
    for name in parser.parse_args().tables:
        put("diagnosis.md", name, TABLES[name]())


if __name__ == "__main__":
    main()
