# SPDX-License-Identifier: Apache-2.0
"""The diagnosis is right on every bag of the labelled set and of the real nodes, findings on a part of the faults."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bench.figures import placed
from diagnosis_benchmark import faults
from diagnosis_benchmark.cases import DEGRADED, HOLDING, TUNING_SEED, UNDECIDED, VALIDATION_SEED, VIOLATED, Case, cases
from diagnosis_benchmark.lock_step import read_record
from diagnosis_benchmark.tables import KINDS, NAMES, diagnosed, diagnosed_cause, outcome, right, table
from fjr_core.config.scenario import load_scenario
from fjr_monitor.diagnosis.diagnosis import diagnose
from fjr_msgs_py.console.ending import Exit
from system.executables import fjr_here

pytestmark = pytest.mark.system
SET = cases(VALIDATION_SEED)


SIDES = re.compile(r"(?<=imperfections\.)(link|motor|state|command)_")


def marked() -> Iterator[Any]:
    """Return the set; the full suite alone has the second level of an imperfection, and that of the other side.

    Of the rates, a stable one is tried, too.
    """
    tried: Counter[frozenset[str]] = Counter()
    for case in SET:
        stable = {"stable"} if case.changes.get("publish_rate", 0.0) >= 200.0 else set()  # Hz
        words = frozenset(SIDES.sub("", name) for name in case.robot or case.changes) | stable
        yield pytest.param(case, id=case.name, marks=pytest.mark.full if tried[words] else ())
        tried[words] += bool(words)


def test_set_covers_all_causes_and_robots_and_the_page_shows_it() -> None:
    """The table of the page is diagonal if every bag is right; its numbers are those of the set."""
    assert len(SET) >= 40
    assert len({case.name for case in SET}) == len(SET)
    healthy = {case.scenario for case in SET if not case.changes and not case.robot}
    assert healthy == {"paper_k31", "paper_k3p1", "two_link", "arm7"}
    words = [word for case in SET for word in case.changes if word.startswith("imperfections.")]
    strengths = {word: words.count(word) for word in words if not word.endswith(("seed", "payload_position"))}
    assert len(strengths) >= 24
    assert min(strengths.values()) >= 2
    assert VALIDATION_SEED != TUNING_SEED
    rows = [line for line in placed("diagnosis.md", "causes").splitlines() if line.startswith("| ")]
    causes, grades = rows[2 : 2 + len(NAMES)], rows[4 + len(NAMES) : 8 + len(NAMES)]
    for part in (causes, grades):
        assert sum(int(cell) for line in part for cell in line.split("|")[2:-1] if cell.strip()) == len(SET)
    assert [line.split("|")[1].strip() for line in grades] == [HOLDING, DEGRADED, UNDECIDED, VIOLATED]
    assert table([("delay", "delay"), ("loss", "unknown")])[0].endswith("| sampling | unknown |")


@pytest.mark.parametrize("case", list(marked()))
def test_diagnosis_of_each_bag_is_its_label(case: Case, tmp_path: Path) -> None:
    label, verdict = diagnosed(case, tmp_path / "bag")
    assert right(label, verdict), (label, verdict)


@pytest.mark.parametrize(
    ("assignment", "wanted"),
    [
        pytest.param("imperfections.command_loss:=0.4", "loss", marks=pytest.mark.full),
        ("limits.effort:=[0.75]", "saturation"),
    ],
)
def test_diagnosis_of_bags_of_the_real_nodes(assignment: str, wanted: str, tmp_path: Path) -> None:
    """The tutorial's page runs holding, sampling, delay and model mismatch; the set saturates the robot itself."""
    arguments = ["run", "paper_k31", "--lockstep", "--no-report", "--duration", "1.25", "--output", str(tmp_path)]
    fjr_here(*arguments, "--set", assignment, codes=(Exit.DONE, Exit.VIOLATED))
    scenario = load_scenario(tmp_path / "paper_k31" / "scenario.yaml")
    verdict = diagnose(read_record(tmp_path / "paper_k31" / "bag", scenario), scenario.tracking_law)
    assert diagnosed_cause(verdict) == wanted, verdict


# Labelled faults; that wrong wiring stops the controller before the arm moves far: test_wiring_faults.py.


FAULTY = faults.cases(faults.VALIDATION_SEED)
SEVERAL = [case for case in FAULTY if case.scenario == "two_link" and case.kind in faults.FAULTS][2::6]
SEVERAL += [case for case in FAULTY if case.scenario == "two_link" and case.kind in faults.WIRING][2::3]


def test_the_set_of_faults_has_every_fault_in_three_sizes_and_the_page_the_required_shares() -> None:
    assert len({*faults.FAULTS, *faults.WIRING}) >= 12
    assert len(FAULTY) >= 48
    for kind in faults.FAULTS:
        for robot in ("paper_k31", "two_link", "arm7"):
            sizes = [case.size for case in FAULTY if (case.kind, case.scenario) == (kind, robot)]
            assert len(sizes) == 3
            assert sizes == sorted(set(sizes))
    assert sum(case.kind == faults.HEALTHY for case in FAULTY) >= 12
    assert faults.VALIDATION_SEED not in faults.TUNING_SEEDS
    page = placed("diagnosis.md", "faults")
    rows = [line for line in page.splitlines() if line.startswith("| ")][2 : 2 + len(KINDS)]
    assert sum(int(cell) for row in rows for cell in row.split("|")[2:-2] if cell.strip()) == len(FAULTY)
    assert all(row.split("|")[-2].strip() != "0/0" for row in rows)
    kind, joint = map(float, re.findall(r"kind right in ([\d.]+) % alone, .* joint in ([\d.]+) %", page)[0])
    assert kind >= 90
    assert joint >= 95


@pytest.mark.parametrize("case", SEVERAL, ids=lambda case: case.name)
def test_kind_and_joint_of_the_largest_faults_are_right(case: Case) -> None:
    result = outcome(case)
    assert (result.found, result.joint) == (case.kind, True)


@pytest.mark.parametrize(
    "case", [case for case in FAULTY if case.kind == faults.HEALTHY][1:9:3], ids=lambda case: case.name
)
def test_healthy_runs_have_no_finding(case: Case) -> None:
    assert outcome(case).found == faults.HEALTHY
