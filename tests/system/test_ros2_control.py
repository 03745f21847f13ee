# SPDX-License-Identifier: Apache-2.0
"""`fjr export-ros2-control`: the command, and where ros2_control is sourced the whole package, built and tested."""

from __future__ import annotations

import json
import os
from pathlib import Path
from xml.etree import ElementTree

import pytest

from system.executables import fjr_here
from system.test_export_command import run, tool

pytestmark = pytest.mark.system
PREFIXES = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
SOURCED = any((prefix / "share" / "controller_interface").is_dir() for prefix in PREFIXES)


@pytest.mark.skipif(not SOURCED, reason="ros2_control is not sourced: no package controller_interface")
def test_the_package_builds_without_warnings_and_its_test_passes(tmp_path: Path) -> None:
    fjr_here("export-ros2-control", "two_link", str(tmp_path / "src" / "two_link_ros2_control"))
    bases = [word for base in ("build", "install") for word in (f"--{base}-base", str(tmp_path / base))]
    colcon = tool("colcon"), "--log-base", tmp_path / "log"
    assert "1 package finished" in run(*colcon, "build", "--base-paths", tmp_path / "src", *bases)
    tests = "--base-paths", tmp_path / "src", *bases, "--return-code-on-test-failure"
    assert "1 package finished" in run(*colcon, "test", *tests)


def test_the_command_writes_a_whole_package(tmp_path: Path) -> None:
    folder = tmp_path / "arm"
    change = "--set", "imperfections.actuator_lag:=[0.002, 0.002]", "--set", "imperfections.state_jitter:=0.001"
    output = json.loads(fjr_here("export-ros2-control", "two_link", str(folder), "--package", "arm", *change, "--json"))
    assert output["package"] == "arm"
    assert output["not_exported"] == ["imperfections.state_jitter"]
    assert sorted(output["files"]) == sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    assert "`imperfections.state_jitter`" in (folder / "README.md").read_text()
    assert ElementTree.parse(folder / "package.xml").findtext("name") == "arm"
    urdf = ElementTree.parse(folder / "urdf" / "arm.urdf")
    lag = next(each for each in urdf.iter("param") if each.get("name") == "actuator_lag")
    assert lag.text == "0.002 0.002"


@pytest.mark.parametrize(
    ("arguments", "words", "code"),
    [
        (["two_link", "DIR", "--package", "My-Arm"], "expected a lower-case letter", 2),
        (["paper_k99", "DIR"], "unknown scenario", 2),
        (["two_link", "file"], "is not a folder", 1),
        (["two_link"], "DIR", 2),
    ],
)
def test_invalid_arguments_are_refused_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str, code: int
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert words in fjr_here("export-ros2-control", *arguments, code=code)
    assert not (tmp_path / "DIR").exists()
