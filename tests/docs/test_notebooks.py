# SPDX-License-Identifier: Apache-2.0
"""Every notebook runs from top to bottom in one process and prints what it shows; its links lead to files."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from time_limits import HANG

NOTEBOOKS = sorted((Path(__file__).parents[2] / "examples" / "notebooks").glob("*.ipynb"))
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
AGREE = 0.02
"""Relative difference of numbers: libraries of another machine round differently."""


def cells(path: Path, kind: str) -> list[dict[str, Any]]:
    return [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == kind]


def shown(path: Path) -> str:
    """Return what the cells of a notebook print, as stored."""
    outputs = [output for cell in cells(path, "code") for output in cell["outputs"]]
    assert not [each for each in outputs if each["output_type"] == "error" or each.get("name") == "stderr"]
    return "".join("".join(each["text"]) for each in outputs if each["output_type"] == "stream")


def test_there_are_four_notebooks() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["compare_two_laws", "contraction", "paper", "your_arm"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_prints_what_it_shows(path: Path) -> None:
    script = "\n".join("".join(cell["source"]) for cell in cells(path, "code"))
    env = {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=path.parent, env=env, capture_output=True, text=True, timeout=HANG
    )
    assert done.returncode == 0, done.stderr
    assert NUMBER.split(done.stdout) == NUMBER.split(shown(path))
    said, stored = ([float(number) for number in NUMBER.findall(text)] for text in (done.stdout, shown(path)))
    assert said == pytest.approx(stored, rel=AGREE)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_links_of_a_notebook_lead_to_files(path: Path) -> None:
    text = "\n".join("".join(cell["source"]) for cell in cells(path, "markdown"))
    links = re.findall(r"\]\(([^)#]+)", text)
    assert all((path.parent / link).is_file() for link in links), links
