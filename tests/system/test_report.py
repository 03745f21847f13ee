# SPDX-License-Identifier: Apache-2.0
"""The report counts missed, late, unanswered and lost samples; the demo runs in real time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fjr_bringup.analysis.run_data import RunData
from fjr_bringup.analysis.timing import counts as counts_of
from fjr_bringup.cli import run
from fjr_bringup.cli.exit_codes import Exit
from fjr_bringup.plotting.picture import LABEL_GAP, apart, labels
from fjr_bringup.scenarios import library
from fjr_core.monitoring.certificate import CertificateSeries
from system.executables import fjr, scenario

pytestmark = pytest.mark.system
MS = 1e-3


def recorded(stamps: list[float], answers: list[float]) -> RunData:
    """Return five nominal samples of 1 ms: states at `stamps` [ms], sent at once, commands at `answers` [ms]."""
    t = MS * np.array(stamps)
    one, two, V = np.zeros((len(stamps), 1)), np.zeros((len(stamps), 2)), np.zeros(len(stamps))
    return RunData(
        joints=("joint1",),
        sample_period=MS,
        lockstep=False,
        beta=10.0,
        beta_is_proven=True,
        effort_limit=np.array([np.inf]),
        t=t,
        position=two,
        velocity=two,
        jets=np.zeros((len(stamps), 5, 1)),
        u=one,
        torque=one,
        u_applied=None,
        certificate=CertificateSeries(*(V,) * 5, u_law=one, slope=two, drive=one, dissipation=V),
        dV=V[1:],
        sent=t,
        answered=MS * np.array(answers),
        reference_mismatch=0.0,
    )


def test_a_perfect_run_has_nothing_to_report() -> None:
    counts = counts_of(recorded([0, 1, 2, 3, 4], [0.3, 1.3, 2.3, 3.3, 4.3]), 5 * MS, {"/joint_states": 0})
    assert (counts.nominal, counts.published, counts.answered_in_time) == (5, 5, 5)
    assert (counts.missing, counts.gaps, counts.late, counts.unanswered) == (0, 0, 0, 0)
    assert counts.answered_in_time_fraction == 1.0


def test_missed_late_unanswered_and_lost_samples_are_counted() -> None:
    data = recorded([0, 1, 3, 4], [0.3, 3.2, np.nan, 4.3])  # 2 is skipped, 1 answered after 3, 3 unanswered
    counts = counts_of(data, 5 * MS, {"/joint_states": 7})
    assert (counts.published, counts.missing, counts.gaps) == (4, 1, 1)
    assert (counts.answered, counts.answered_in_time, counts.late, counts.unanswered) == (3, 2, 1, 1)
    assert counts.longest_gap_s == pytest.approx(2 * MS)
    assert counts.answered_in_time_fraction == pytest.approx(2 / 5)
    assert counts.lost_by_recorder == {"/joint_states": 7}


@given(st.lists(st.floats(-2.0, 3.0), min_size=1, max_size=9))
def test_joint_labels_are_within_the_axes_and_separated_in_order_only_if_they_overlap(heights: list[float]) -> None:
    placed = np.array(apart(np.array(heights)))
    order = np.argsort(placed)
    assert np.all(np.diff(np.array(heights)[order]) >= 0)
    assert np.all(np.diff(placed[order]) >= LABEL_GAP - 1e-9)
    assert -1e-9 <= placed.min() <= placed.max() <= 1 + 1e-9
    if placed.min() > 1e-9 and placed.max() < 1 - 1e-9:
        np.testing.assert_allclose(np.mean(placed), np.mean(heights), atol=1e-9)
    if np.all(np.diff(np.sort(heights)) >= LABEL_GAP) and 0 <= min(heights) <= max(heights) <= 1:
        np.testing.assert_allclose(placed, heights, atol=1e-9)


def test_joint_labels_are_short_and_differ() -> None:
    assert labels(["shoulder_pan_joint", "elbow_joint"]) == ["shoulder_pan", "elbow"]
    assert labels(["shoulder_pan_joint", "elbow"]) == ["…ulder_pan_joint", "elbow"]
    assert labels(["panda_left_arm_joint1", "panda_left_arm_joint2"]) == ["…left_arm_joint1", "…left_arm_joint2"]


@pytest.mark.real_time
def test_the_demo_runs_the_paper_and_an_arm_in_real_time(tmp_path: Path) -> None:
    said = fjr("demo", "--duration", "0.5", "--output", str(tmp_path), codes=(Exit.DONE, Exit.VIOLATED, Exit.LATE))
    for name in ("paper_k31", "paper_k3p1", "arm7"):
        counts = json.loads((tmp_path / name / "report.json").read_text())["counts"]
        assert counts["nominal"] == counts["published"] + counts["missing"] == 500
        assert counts["published"] == counts["answered_in_time"] + counts["late"] + counts["unanswered"] > 0
        assert (tmp_path / name / "bag" / "metadata.yaml").is_file()
        assert (tmp_path / name / "overview.png").is_file()
        assert (tmp_path / name / "report.html").is_file()
        assert name in said
    page = (tmp_path / "comparison.html").read_text()
    assert "The paper's claim" in said
    assert "The paper&#39;s claim" in page


def test_a_demonstration_that_the_computer_is_too_slow_for_is_repeated_in_lock_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stopping = tmp_path / "stopping.yaml"
    text, _ = library.as_run(Path(scenario("paper_k31")), {"limits.tracking_error": [0.2]})
    stopping.write_text(text)
    monkeypatch.setattr(run, "KEEPS_UP", 1.1)
    summary = run._demonstrate(str(stopping), 0.3, tmp_path / "runs")
    assert summary.report.stop is not None
    assert summary.report.lockstep
    assert "repeated in lock-step" in capsys.readouterr().err
    assert ["repeated in lock-step" in note for note in summary.notes] == [True]
    assert len(list((tmp_path / "runs").glob("stopping-*"))) == 2
