# SPDX-License-Identifier: Apache-2.0
"""The controller in C++ of docs/export_c.md, driven on the exported plant: it tracks as the Python does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from core.c_program import C99, CPP, SCENARIOS, built, exported, loop, said
from docs.pages import ROOT, blocks
from fjr_core.scenario import load_scenario

HERE = Path(__file__).with_name("ros2_control")


def test_the_controller_of_the_page_tracks(tmp_path: Path) -> None:
    folder = exported(loop("paper_k31"), tmp_path / "paper_k31")
    source = tmp_path / "controller.cpp"
    source.write_text(next(block.text for block in blocks(ROOT / "docs" / "export_c.md") if block.language == "cpp"))
    objects = [built(C99, [file], file.with_suffix(".o"), "-c") for file in folder.glob("paper_k31*.c")]
    where = f"-I{HERE / 'include'}", f"-I{folder}"
    worst, first, stops = said(built(CPP, [source, HERE / "drive.cpp", *objects], tmp_path / "drive", *where)).split()
    run = load_scenario(SCENARIOS / "paper_k31.yaml").simulate(4.0)
    late = run.t >= 2.0
    assert float(first) == pytest.approx(run.u[0, 0], rel=1e-12)
    assert float(worst) == pytest.approx(np.abs(run.x[late, 0] - run.jets[late, 0, 0]).max(), rel=1e-3)
    assert stops == "stops"
