# SPDX-License-Identifier: Apache-2.0
"""The diagnosis is right on every bag of the labelled set and on bags of the real nodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bench.figures import placed
from diagnosis_benchmark.cases import DEGRADED, HOLDING, TUNING_SEED, UNDECIDED, VALIDATION_SEED, VIOLATED, Case, cases
from diagnosis_benchmark.lock_step import read_record
from diagnosis_benchmark.tables import NAMES, diagnosed, diagnosed_cause, right, table
from fjr_core.config.scenario import load_scenario
from fjr_monitor.diagnosis.diagnosis import diagnose
from fjr_msgs_py.console.ending import Exit
from system.executables import fjr_here

pytestmark = pytest.mark.system
SET = cases(VALIDATION_SEED)


def marked() -> Iterator[Any]:
    """Return the set; further changes of the same parameters are for the full suite alone, but for one stable rate."""
    tried: Counter[frozenset[str]] = Counter()
    for case in SET:
        stable = {"stable"} if case.changes.get("publish_rate", 0.0) >= 200.0 else set()  # Hz
        words = frozenset(case.robot or case.changes) | stable
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
