# SPDX-License-Identifier: Apache-2.0
"""The diagnosis is right on every bag of the labelled set and on bags of the real nodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from diagnosis_benchmark.bags import read_record
from diagnosis_benchmark.cases import DEGRADED, HOLDING, TUNING_SEED, UNDECIDED, VALIDATION_SEED, VIOLATED, Case, cases
from diagnosis_benchmark.tables import NAMES, begin, diagnosed, diagnosed_cause, right, table
from fjr_core.config.scenario import load_scenario
from fjr_monitor.diagnosis.diagnosis import Diagnosis, diagnose
from fjr_msgs_py.console.ending import Exit
from system.executables import fjr_here
from system.shared_runs import shared_run

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.system
SET = cases(VALIDATION_SEED)


def marked() -> Iterator[Any]:
    """Return the set; of each imperfection's two strengths the second is for the full suite alone."""
    tried: Counter[frozenset[str]] = Counter()
    for case in SET:
        words = frozenset(word for word in case.changes if word.startswith("imperfections."))
        yield pytest.param(case, id=case.name, marks=pytest.mark.full if tried[words] % 2 else ())
        tried[words] += bool(words)


def test_set_covers_all_causes_and_robots() -> None:
    assert len(SET) >= 40
    assert len({case.name for case in SET}) == len(SET)
    assert {case.scenario for case in SET if not case.changes and not case.robot} == {
        "paper_k31",
        "paper_k3p1",
        "two_link",
        "arm7",
    }
    words = [word for case in SET for word in case.changes if word.startswith("imperfections.")]
    strengths = {word: words.count(word) for word in words if not word.endswith(("seed", "payload_position"))}
    assert len(strengths) >= 24
    assert min(strengths.values()) >= 2
    assert VALIDATION_SEED != TUNING_SEED


@pytest.mark.parametrize("case", list(marked()))
def test_diagnosis_of_each_bag_is_its_label(case: Case, tmp_path: Path) -> None:
    label, verdict = diagnosed(case, tmp_path / "bag")
    assert right(label, verdict), (label, verdict)


def test_the_page_shows_the_set() -> None:
    """The table is diagonal if every bag is right; its numbers are those of the set."""
    page = (ROOT / "docs" / "tables" / "diagnosis.md").read_text(encoding="utf-8").partition(begin("causes"))[2]
    rows = [line for line in page.splitlines() if line.startswith("| ")]
    causes, grades = rows[2 : 2 + len(NAMES)], rows[4 + len(NAMES) : 8 + len(NAMES)]
    for part in (causes, grades):
        assert sum(int(cell) for line in part for cell in line.split("|")[2:-1] if cell.strip()) == len(SET)
    assert [line.split("|")[1].strip() for line in grades] == [HOLDING, DEGRADED, UNDECIDED, VIOLATED]
    assert table([("delay", "delay"), ("loss", "unknown")])[0].endswith("| sampling | unknown |")


@pytest.mark.parametrize(
    ("assignments", "wanted"),
    [
        (("imperfections.motor_coulomb_friction:=[0.05]",), "model mismatch"),
        (("imperfections.command_delay:=0.002",), "delay"),
        (("imperfections.command_loss:=0.4",), "loss"),
        (("imperfections.effort_limit:=[0.75]",), "saturation"),
        (("limits.effort:=[0.75]",), "saturation"),
        (("publish_rate:=50.0",), "sampling"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_diagnosis_of_bags_of_the_real_nodes(assignments: tuple[str, ...], wanted: str, tmp_path: Path) -> None:
    changes = [part for assignment in assignments for part in ("--set", assignment)]
    force = ["--force"] if wanted == "sampling" else []
    duration = "0.5" if wanted == "sampling" else "1.25"
    arguments = ["run", "paper_k31", "--lockstep", "--no-report", "--duration", duration, "--output", str(tmp_path)]
    fjr_here(*arguments, *changes, *force, codes=(Exit.DONE, Exit.VIOLATED))
    verdict = verdict_on(tmp_path / "paper_k31")
    assert diagnosed_cause(verdict) == wanted, verdict


def test_real_nodes_as_they_are_hold_the_bound(tmp_path_factory: pytest.TempPathFactory) -> None:
    verdict = verdict_on(shared_run(tmp_path_factory, "paper_k31"))
    assert diagnosed_cause(verdict) == "holding", verdict


def verdict_on(folder: Path) -> Diagnosis:
    scenario = load_scenario(folder / "scenario.yaml")
    return diagnose(read_record(folder / "bag", scenario), scenario.tracking_law)
