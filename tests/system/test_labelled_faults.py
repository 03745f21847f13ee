# SPDX-License-Identifier: Apache-2.0
"""Findings are right on a part of the labelled faults; wrong wiring stops the controller before the arm moves far."""

from __future__ import annotations

import re

import pytest

from bench.figures import placed
from diagnosis_benchmark.cases import Case
from diagnosis_benchmark.faults import (
    FAULTS,
    HEALTHY,
    TUNING_SEEDS,
    VALIDATION_SEED,
    WIRING,
    cases,
)
from diagnosis_benchmark.tables import KINDS, outcome

pytestmark = pytest.mark.system
SET = cases(VALIDATION_SEED)
SEVERAL = [case for case in SET if case.scenario == "two_link" and case.kind in FAULTS][2::6]
SEVERAL += [case for case in SET if case.scenario == "two_link" and case.kind in WIRING][2::3]


def test_set_has_every_fault_in_three_sizes_and_the_page_the_required_shares() -> None:
    assert len({*FAULTS, *WIRING}) >= 12
    assert len(SET) >= 48
    for kind in FAULTS:
        for robot in ("paper_k31", "two_link", "arm7"):
            sizes = [case.size for case in SET if (case.kind, case.scenario) == (kind, robot)]
            assert len(sizes) == 3
            assert sizes == sorted(set(sizes))
    assert sum(case.kind == HEALTHY for case in SET) >= 12
    assert VALIDATION_SEED not in TUNING_SEEDS
    page = placed("diagnosis.md", "faults")
    rows = [line for line in page.splitlines() if line.startswith("| ")][2 : 2 + len(KINDS)]
    assert sum(int(cell) for row in rows for cell in row.split("|")[2:-2] if cell.strip()) == len(SET)
    assert all(row.split("|")[-2].strip() != "0/0" for row in rows)
    kind, joint = map(float, re.findall(r"kind right in ([\d.]+) % alone, .* joint in ([\d.]+) %", page)[0])
    assert kind >= 90
    assert joint >= 95


@pytest.mark.parametrize("case", SEVERAL, ids=lambda case: case.name)
def test_kind_and_joint_of_the_largest_faults_are_right(case: Case) -> None:
    result = outcome(case)
    assert (result.found, result.joint) == (case.kind, True)


@pytest.mark.parametrize("case", [case for case in SET if case.kind == HEALTHY][1:9:3], ids=lambda case: case.name)
def test_healthy_runs_have_no_finding(case: Case) -> None:
    assert outcome(case).found == HEALTHY
