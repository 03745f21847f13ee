# SPDX-License-Identifier: Apache-2.0
"""Findings are right on a part of the labelled faults; wrong wiring stops the controller before the arm moves far."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from diagnosis_benchmark.cases import Case
from diagnosis_benchmark.faults import (
    FAULTS,
    HEALTHY,
    TUNING_SEEDS,
    VALIDATION_SEED,
    WIRING,
    cases,
    duration_of,
    joints_of,
)
from diagnosis_benchmark.tables import KINDS, begin, outcome
from fjr_core.monitoring.certificate import Certificate

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.system
SET = cases(VALIDATION_SEED)
SEVERAL = [case for case in SET if case.scenario == "two_link" and case.kind in FAULTS][2::6]
MISWIRED = [case for case in SET if case.scenario == "two_link" and case.kind in WIRING][2::3]


def test_set_has_every_fault_in_three_sizes_and_healthy_runs() -> None:
    assert len({*FAULTS, *WIRING}) >= 12
    assert len(SET) >= 48
    for kind in FAULTS:
        for robot in ("paper_k31", "two_link", "arm7"):
            sizes = [case.size for case in SET if (case.kind, case.scenario) == (kind, robot)]
            assert len(sizes) == 3
            assert sizes == sorted(set(sizes))
    assert sum(case.kind == HEALTHY for case in SET) >= 12
    assert VALIDATION_SEED not in TUNING_SEEDS


@pytest.mark.parametrize("case", SEVERAL, ids=lambda case: case.name)
def test_kind_and_joint_of_the_largest_faults_are_right(case: Case) -> None:
    result = outcome(case)
    assert (result.found, result.joint) == (case.kind, True)


@pytest.mark.parametrize("case", MISWIRED, ids=lambda case: case.name)
def test_wrong_wiring_stops_the_controller_without_effort_and_is_named(case: Case) -> None:
    loop = case.run(duration_of(case))
    record = loop.record()
    assert loop.tracker.state.value == "stopped"
    assert all(name in loop.tracker.reason for name in joints_of(case).split(" and "))
    assert not record.u[-1].any()
    assert outcome(case).found == case.kind
    if case.kind == "efforts exchanged":
        answered = np.flatnonzero(record.u.any(axis=1))
        assert answered[-1] < 20
        V = Certificate(loop.scenario.tracking_law).along(record.position, record.velocity, record.jets).V
        assert V[:30].max() < 1e3 * V[0]


@pytest.mark.parametrize("case", [case for case in SET if case.kind == HEALTHY][1:9:3], ids=lambda case: case.name)
def test_healthy_runs_have_no_finding(case: Case) -> None:
    assert outcome(case).found == HEALTHY


def test_saturated_motor_is_not_diagnosed_as_wrong_wiring() -> None:
    """The controller does not know the effort limit."""
    changes: dict[str, object] = {
        "effort_limit": [0.8752888529257113],
        "link_velocity_noise": [0.002808033000353928],
        "motor_velocity_noise": [0.002808033000353928],
        "link_position_noise": [6.577704574985669e-06],
        "motor_position_noise": [6.577704574985669e-06],
        "link_encoder_bits": [14.0],
        "motor_encoder_bits": [13.0],
        "state_delay": 0.00011490071921795886,
        "seed": 936,
    }
    robot: dict[str, object] = {"joint_stiffness": [29.2363], "motor_inertia": [0.0030914], "link_inertia": [0.0375842]}
    start: dict[str, object] = {f"initial_{side}_position": [0.55313696] for side in ("link", "motor")}
    named = {f"imperfections.{name}": value for name, value in changes.items()}
    weak = Case("weak motor", "paper_k31", HEALTHY, named, robot, start)
    assert weak.run(0.25).tracker.state.value == "tracking"


def test_page_shows_the_set_and_the_required_shares() -> None:
    page = (ROOT / "docs" / "tables" / "diagnosis.md").read_text(encoding="utf-8").partition(begin("faults"))[2]
    rows = [line for line in page.splitlines() if line.startswith("| ")][2 : 2 + len(KINDS)]
    counts = [int(cell) for row in rows for cell in row.split("|")[2:-2] if cell.strip()]
    assert sum(counts) == len(SET)
    assert all(row.split("|")[-2].strip() != "0/0" for row in rows)
    kind, joint = map(float, re.findall(r"kind right in ([\d.]+) %, joint in ([\d.]+) %", page)[0])
    assert kind >= 90
    assert joint >= 95
