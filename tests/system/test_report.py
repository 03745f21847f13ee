# SPDX-License-Identifier: Apache-2.0
"""The report counts every sample: missed, late, unanswered and lost ones; and the demo runs in real time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fjr_bringup.report import _counts
from fjr_bringup.tracking_data import TrackingData
from system.executables import fjr

pytestmark = pytest.mark.system
MS = 1e-3


def recorded(stamps: list[float], answers: list[float]) -> TrackingData:
    """Five nominal samples of 1 ms: states at `stamps` [ms], sent at once, answered at `answers` [ms]."""
    t, zeros = MS * np.array(stamps), np.zeros((len(stamps), 1))
    return TrackingData(("joint1",), MS, 10.0, t, zeros, zeros, zeros, zeros[:, 0], t, MS * np.array(answers), 0.0)


def test_a_perfect_run_has_nothing_to_report() -> None:
    counts = _counts(recorded([0, 1, 2, 3, 4], [0.3, 1.3, 2.3, 3.3, 4.3]), 5 * MS, {"/joint_states": 0})
    assert (counts.nominal, counts.published, counts.answered_in_time) == (5, 5, 5)
    assert (counts.missing, counts.gaps, counts.late, counts.unanswered) == (0, 0, 0, 0)
    assert counts.answered_in_time_fraction == 1.0


def test_missed_late_unanswered_and_lost_are_each_counted() -> None:
    data = recorded([0, 1, 3, 4], [0.3, 3.2, np.nan, 4.3])  # 2 was skipped, 1 answered after 3, 3 not at all
    counts = _counts(data, 5 * MS, {"/joint_states": 7})
    assert (counts.published, counts.missing, counts.gaps) == (4, 1, 1)
    assert (counts.answered, counts.answered_in_time, counts.late, counts.unanswered) == (3, 2, 1, 1)
    assert counts.longest_gap_s == pytest.approx(2 * MS)
    assert counts.answered_in_time_fraction == pytest.approx(2 / 5)
    assert counts.lost_by_recorder == {"/joint_states": 7}


def test_the_demo_runs_both_scenarios_in_real_time(tmp_path: Path) -> None:
    said = fjr("demo", "--duration", "0.5", "--output", str(tmp_path))
    for name in ("paper_k31", "paper_k3p1"):
        counts = json.loads((tmp_path / name / "report.json").read_text())["counts"]
        assert counts["nominal"] == counts["published"] + counts["missing"] == 500
        assert counts["published"] == counts["answered_in_time"] + counts["late"] + counts["unanswered"] > 0
        assert (tmp_path / name / "bag" / "metadata.yaml").is_file()
        assert (tmp_path / name / "overview.png").is_file()
        assert name in said
