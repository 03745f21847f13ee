# SPDX-License-Identifier: Apache-2.0
"""docs/reports.md lists the exit codes of `fjr` as `fjr --help` does, each command returns 2 for a bad file."""

from __future__ import annotations

import re
from pathlib import Path

import click
import pytest

from docs.pages import ROOT
from fjr_bringup.cli.app import fjr
from fjr_msgs_py.console.ending import MEANINGS, Exit
from system.executables import fjr_here


def test_every_exit_code_is_documented() -> None:
    page = (ROOT / "docs" / "reports.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| (.*) \|$", page, flags=re.MULTILINE)
    assert {int(code): meaning for code, meaning in rows} == {code.value: MEANINGS[code] for code in Exit}
    said = fjr.get_help(click.Context(fjr, info_name="fjr"))
    assert all(f"  {code:<4} {meaning.replace('`', '')}" in said for code, meaning in MEANINGS.items())


GIVEN_A_FILE = {
    **{name: (name, "FILE") for name in ("run", "check", "excite", "description", "sweep", "tune")},
    **{name: (name, "FILE") for name in ("new", "report", "compare", "play")},
    "gains": ("gains", "FILE", "--beta", "1"),
    "export-c": ("export-c", "FILE", "made"),
    "export-ros2-control": ("export-ros2-control", "FILE", "made"),
    "export-mjcf": ("export-mjcf", "FILE", "made.xml"),
    "identify, robot": ("identify", "log.csv", "--robot", "FILE"),
    "identify, record": ("identify", "FILE", "--robot", "joint.yaml", "--map", "map.yaml"),
    "identify, map": ("identify", "log.csv", "--robot", "joint.yaml", "--map", "FILE"),
    "watch": ("watch", "FILE", "--once"),
}


@pytest.mark.parametrize("command", GIVEN_A_FILE)
@pytest.mark.parametrize("file", ["missing.yaml", "empty.yaml", "binary.csv"])
def test_a_file_that_is_missing_or_not_valid_gives_exit_code_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, file: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.yaml").write_text("")
    (tmp_path / "binary.csv").write_bytes(bytes(range(256)))
    (tmp_path / "log.csv").write_text("t,u,q\n0,0,0\n")
    (tmp_path / "joint.yaml").write_text("/**: {ros__parameters: {joints: [joint1]}}\n")
    (tmp_path / "map.yaml").write_text(
        "time: {column: t}\nmotor_position: {column: q, unit: rad}\neffort: {column: u, unit: N m}\n"
    )
    said = fjr_here(*(file if word == "FILE" else word for word in GIVEN_A_FILE[command]), code=Exit.NOT_UNDERSTOOD)
    assert "fjr: " in said or "Error" in said
    assert "Traceback" not in said
