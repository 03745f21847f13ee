# SPDX-License-Identifier: Apache-2.0
"""The demo runs in real time, in lock-step where the machine is too slow."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from fjr_bringup.cli import run
from fjr_msgs_py.scenarios import library
from system.executables import fjr, scenario

pytestmark = pytest.mark.system


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
