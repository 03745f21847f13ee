# SPDX-License-Identifier: Apache-2.0
"""Every example runs unchanged; a notebook prints what it shows, and its links lead to files."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from docs.pages import ROOT
from system.executables import python_here

OF_FILES = {"recorded_motion_in_mujoco"}
"""Examples that are given files; tests/engines runs them."""
EXAMPLES = sorted(path for path in (ROOT / "examples").glob("*.py") if path.stem not in OF_FILES)
NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
AGREE = 0.02
"""Relative difference of numbers: libraries of another machine round differently."""
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path: Path) -> None:
    assert python_here(path.read_text(encoding="utf-8"), path)


def cells(path: Path, kind: str) -> list[dict[str, Any]]:
    return [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == kind]


def shown(path: Path) -> str:
    """Return what the cells of a notebook print, as stored."""
    outputs = [output for cell in cells(path, "code") for output in cell["outputs"]]
    assert not [each for each in outputs if each["output_type"] == "error" or each.get("name") == "stderr"]
    return "".join("".join(each["text"]) for each in outputs if each["output_type"] == "stream")


@each_notebook
def test_notebook_runs_prints_what_it_shows_and_links_to_files(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(path.parent)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    said = python_here("\n".join("".join(cell["source"]) for cell in cells(path, "code")), path)
    assert NUMBER.split(said) == NUMBER.split(shown(path))
    printed, stored = ([float(number) for number in NUMBER.findall(text)] for text in (said, shown(path)))
    assert printed == pytest.approx(stored, rel=AGREE)
    text = "\n".join("".join(cell["source"]) for cell in cells(path, "markdown"))
    links = re.findall(r"\]\(([^)#]+)", text)
    assert all((path.parent / link).is_file() for link in links), links
