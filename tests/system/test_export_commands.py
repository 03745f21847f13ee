# SPDX-License-Identifier: Apache-2.0
"""`fjr export-c` and `fjr export-ros2-control`: CMake, and colcon where ros2_control is sourced, build the folder."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from system.executables import fjr_here, fjr_json
from time_limits import HANG

pytestmark = pytest.mark.system
PREFIXES = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
SOURCED = any((prefix / "share" / "controller_interface").is_dir() for prefix in PREFIXES)


def tool(name: str) -> str:
    """Return a tool of CMake, from the packages for tests or, with a sourced ROS 2, from the system."""
    neighbour = Path(sys.executable).with_name(name)
    return str(neighbour) if neighbour.exists() else shutil.which(name) or name


def run(*command: str | Path) -> str:
    outside = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL")}
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, timeout=HANG, env=outside)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "warning" not in done.stderr
    return done.stdout


CONSUMER = """
cmake_minimum_required(VERSION 3.16)
project(consumer CXX C)
add_subdirectory(law)
add_library(controller MODULE controller.cpp)
target_link_libraries(controller PRIVATE arm)
"""
CONTROLLER = """
#include "arm.h"
static_assert(ARM_N == 1, "one joint");
extern "C" int effort(const arm_model *model, arm_controller *state, const arm_sample *sample, arm_command *command)
{
  return arm_step(model, state, sample, 0, command);
}
"""


def test_export_links_into_a_cpp_plugin(tmp_path: Path) -> None:
    """The plugin is a shared object like the controllers of ros2_control."""
    fjr_here("export-c", "paper_k31", str(tmp_path / "law"), "--prefix", "arm")
    (tmp_path / "CMakeLists.txt").write_text(CONSUMER)
    (tmp_path / "controller.cpp").write_text(CONTROLLER)
    run(tool("cmake"), "-S", tmp_path, "-B", tmp_path / "build")
    run(tool("cmake"), "--build", tmp_path / "build")
    assert list((tmp_path / "build").glob("libcontroller.*"))


def test_only_an_earlier_export_is_replaced_and_only_with_force(tmp_path: Path) -> None:
    fjr_here("export-c", "paper_k31", str(tmp_path / "new" / "folder"))
    folder = tmp_path / "new" / "folder"
    (folder / "mine.txt").write_text("mine")
    before = (folder / "paper_k31.c").read_text()
    change = ("--set", "gains.K_ld:=[0.7]")
    assert "is not empty; expected a new or empty folder" in fjr_here(
        "export-c", "paper_k31", str(folder), *change, code=1
    )
    assert (folder / "paper_k31.c").read_text() == before
    fjr_here("export-c", "paper_k31", str(folder), *change, "--force")
    assert (folder / "paper_k31.c").read_text() != before
    assert (folder / "mine.txt").read_text() == "mine"


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
    output = fjr_json("export-ros2-control", "two_link", str(folder), "--package", "arm", *change)
    assert output["package"] == "arm"
    assert output["not_exported"] == ["imperfections.state_jitter"]
    assert sorted(output["files"]) == sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    assert "`imperfections.state_jitter`" in (folder / "README.md").read_text()
    assert ElementTree.parse(folder / "package.xml").findtext("name") == "arm"
    urdf = ElementTree.parse(folder / "urdf" / "arm.urdf")
    lag = next(each for each in urdf.iter("param") if each.get("name") == "actuator_lag")
    assert lag.text == "0.002 0.002"
