# SPDX-License-Identifier: Apache-2.0
"""The demo runs in lock-step where the machine is too slow for real time (in real time: test_real_time.py)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fjr_bringup.cli import run
from fjr_msgs_py.scenarios import library
from system.executables import scenario

pytestmark = pytest.mark.system


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
