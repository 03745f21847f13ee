# SPDX-License-Identifier: Apache-2.0
"""`fjr` with a law other than v-dPBC: check before the run, real processes, a report without a certificate."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fjr_core.extensions.law_registry import LAWS
from system.executables import fjr_here

pytestmark = pytest.mark.system


def test_a_run_with_another_law_is_reported_without_v(tmp_path: Path) -> None:
    changed = ("--set", "law.type:=lqr", "--output", str(tmp_path))
    fjr_here("run", "paper_k31", "--lockstep", "--duration", "2.5", *changed)
    report = json.loads((tmp_path / "paper_k31" / "report.json").read_text())
    assert report["verdict"]["kind"] == "unknown"
    assert report["verdict"]["sentence"] == "no diagnosis: the law lqr has no certificate"
    assert report["storage"] is None
    (joint,) = report["joints"]
    assert joint["peak_error_after_2s_rad"] < 1e-3
    assert np.isfinite(joint["peak_effort_nm"])
    assert (tmp_path / "paper_k31" / "report.html").is_file()
    assert (tmp_path / "paper_k31" / "overview.png").is_file()


@pytest.mark.parametrize("name", [name for name in LAWS if name != "v_dpbc"])
def test_check_reports_the_law_its_gains_and_the_sampled_loop(name: str) -> None:
    said = fjr_here("check", "paper_k31", "--set", f"law.type:={name}")
    assert f"{name}: {LAWS[name].title}" in said
    assert "the same bandwidth" in said
    assert "spectral radius" in said
    assert "none for this law" in said
    assert "in the whole range" in said
    assert "beta" not in said
