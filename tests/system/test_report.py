# SPDX-License-Identifier: Apache-2.0
"""The report counts missed, late, unanswered and lost samples; the demo runs in real time."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fjr_bringup.cli import run
from fjr_monitor.analysis import timing
from fjr_monitor.analysis.timing import Clock, Counts, Distribution
from fjr_monitor.plotting.picture import LABEL_GAP, apart, labels
from fjr_msgs_py.scenarios import library
from system.executables import fjr, scenario

pytestmark = pytest.mark.system
MS = 1e-3


def counted(stamps: list[float], answers: list[float], lost: int, split: int, duration: float = 5 * MS) -> Counts:
    """Return the counts of five nominal samples of 1 ms: states at `stamps` [ms], sent at once, commands at `answers`.

    split: number of states in the first of two parts.
    """
    t, clock = MS * np.array(stamps), Clock(MS, lockstep=False)
    clock.add(t[:split], t[:split], MS * np.array(answers[:split]))
    begin = min(2, split)
    late = slice(split - begin, None)
    clock.add(t[late], t[late], MS * np.array(answers[late]), begin)
    return clock.counts(duration, {"/joint_states": lost})


@pytest.mark.parametrize("split", [1, 2, 3])
def test_a_perfect_run_has_nothing_to_report(split: int) -> None:
    counts = counted([0, 1, 2, 3, 4], [0.3, 1.3, 2.3, 3.3, 4.3], 0, split)
    assert (counts.nominal, counts.published, counts.answered_in_time) == (5, 5, 5)
    assert (counts.missing, counts.gaps, counts.late, counts.unanswered) == (0, 0, 0, 0)
    assert counts.answered_in_time_fraction == 1.0


@pytest.mark.parametrize("late", [0.0, 0.3, 0.7, 0.99])
def test_a_run_has_never_more_states_than_nominal_because_its_first_was_late(late: float) -> None:
    stamps = [0.0, *(k - late for k in range(1, 5))]  # times count from the first state
    for count in (5, 6):
        t = [*stamps, 5 - late][:count]
        for duration in (5 * MS, t[-1] * MS + MS):  # as planned, and up to the last state
            kept = [stamp for stamp in t if stamp * MS < duration]
            counts = counted(kept, [stamp + 0.005 for stamp in kept], 0, 2, duration)
            assert counts.missing == 0
            assert counts.answered_in_time_fraction == 1.0


@pytest.mark.parametrize("split", [1, 2, 3])
def test_missed_late_unanswered_and_lost_samples_are_counted(split: int) -> None:
    # 2 is skipped, 1 answered after 3, 3 unanswered
    counts = counted([0, 1, 3, 4], [0.3, 3.2, np.nan, 4.3], 7, split)
    assert (counts.published, counts.missing, counts.gaps) == (4, 1, 1)
    assert (counts.answered, counts.answered_in_time, counts.late, counts.unanswered) == (3, 2, 1, 1)
    assert counts.longest_gap_s == pytest.approx(2 * MS)
    assert counts.answered_in_time_fraction == pytest.approx(2 / 5)
    assert counts.lost_by_recorder == {"/joint_states": 7}


@given(st.lists(st.integers(-(10**12), 10**12), min_size=1, max_size=50), st.floats(0, 1), st.integers(0, 50))
def test_quantiles_are_those_of_all_times(times: list[int], share: float, split: int) -> None:
    found = Distribution()
    for part in (times[:split], times[split:]):
        found.add(np.array(part, dtype=np.int64))
    assert found.count == len(times)
    assert found.quantile(share) == pytest.approx(np.quantile(times, share), rel=1e-12, abs=1e-3)
    assert (found.least, found.largest) == (min(times), max(times))
    np.testing.assert_allclose(found.above(np.array([0.0])), np.mean(np.array(times) > 0))


def test_a_distribution_of_too_many_different_times_halves_its_resolution(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timing, "MOST", 100)
    times, found = np.random.default_rng(0).integers(10**6, 2 * 10**6, 5000), Distribution()
    for part in np.split(times, 10):
        found.add(part)
    assert found.count == 5000
    assert len(found.histogram(np.array([0.0, 1.5e6, 2e6]))) == 2
    assert 1 < found.resolution <= 2**14
    for share in (0.0, 0.1, 0.5, 0.99, 1.0):
        assert 0 <= np.quantile(times, share) - found.quantile(share) <= found.resolution


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
    said = fjr("demo", "--duration", "0.5", "--output", str(tmp_path))
    for name in ("paper_k31", "paper_k3p1", "arm7"):
        counts = json.loads((tmp_path / name / "report.json").read_text())["counts"]
        assert counts["nominal"] == counts["published"] + counts["missing"]
        assert counts["nominal"] in (500, 501)
        assert counts["published"] == counts["answered_in_time"] + counts["late"] + counts["unanswered"] > 0
        assert (tmp_path / name / "bag" / "metadata.yaml").is_file()
        assert (tmp_path / name / "overview.png").is_file()
        assert (tmp_path / name / "report.html").is_file()
        assert name in said
    page = (tmp_path / "comparison.html").read_text()
    assert "The paper's claim" in said
    assert "The paper&#39;s claim" in page


def test_a_demonstration_that_is_stopped_in_real_time_is_repeated_in_lock_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stopping = tmp_path / "stopping.yaml"
    text, _ = library.as_run(Path(scenario("paper_k31")), {"limits.tracking_error": [0.2]})
    stopping.write_text(text)
    summary = run._demonstrate(str(stopping), 0.3, tmp_path / "runs")
    assert summary.report.stop is not None
    assert summary.report.lockstep
    said = capsys.readouterr().err
    assert re.search(r"the run in real time was stopped at 0\S* s, with \d+\S* % of the states .* in lock-step", said)
    assert ["repeated in lock-step" in note for note in summary.notes] == [True]
    assert len(list((tmp_path / "runs").glob("stopping-*"))) == 2
