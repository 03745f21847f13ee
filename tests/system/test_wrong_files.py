# SPDX-License-Identifier: Apache-2.0
"""A file of another kind, or with a name that nothing reads, is refused in one sentence by every command."""

from __future__ import annotations

from pathlib import Path

import pytest

from system.executables import fjr_here
from two_link_urdf import JOINTS, MOTOR_INERTIA, STIFFNESS, two_link_urdf

ROBOT = f"""
/**:
  ros__parameters:
    joints: {JOINTS}
    robot: {{model: urdf, urdf: arm.urdf, joint_stiffness: {STIFFNESS}, motor_inertia: {MOTOR_INERTIA}}}
"""
COMMANDS = {
    "run": ("run", "FILE"),
    "check": ("check", "FILE"),
    "gains": ("gains", "FILE", "--beta", "1"),
    "excite": ("excite", "FILE"),
    "description": ("description", "FILE"),
    "export-c": ("export-c", "FILE", "exported"),
    "export-ros2-control": ("export-ros2-control", "FILE", "exported"),
    "sweep": ("sweep", "FILE"),
    "tune": ("tune", "FILE"),
    "watch": ("watch", "FILE", "--once"),
}
LOOPS = ("run", "check", "export-c", "export-ros2-control", "sweep", "tune")
"""Commands that need motion and gains."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(two_link_urdf())
    (tmp_path / "arm_robot.yaml").write_text(ROBOT)
    return tmp_path


def refused(command: str, file: str) -> str:
    """Return the one sentence with which a command refuses a file."""
    said = fjr_here(*(file if word == "FILE" else word for word in COMMANDS[command]), code=2)
    (sentence,) = [line for line in said.splitlines() if line.startswith("fjr: ")]
    return sentence


def test_names_that_nothing_reads_are_refused(folder: Path) -> None:
    file = folder / "mine.yaml"
    file.write_text("/**: {ros__parameters: {limits: {efort: [1.0]}}}\n")
    assert "unknown parameter 'limits.efort'; did you mean 'limits.effort'?" in refused("check", "mine.yaml")
    file.write_text("robot: {joint_stiffness: [3.1]}\n")
    assert "has 'robot' at the top, where only sections of nodes are read" in refused("check", "mine.yaml")


@pytest.mark.parametrize("command", COMMANDS)
def test_a_urdf_in_place_of_a_scenario_names_the_command_that_makes_one(folder: Path, command: str) -> None:
    assert "expected a scenario: fjr new arm.urdf writes one" in refused(command, "arm.urdf")


@pytest.mark.parametrize("command", LOOPS)
def test_a_robot_file_in_place_of_a_scenario_names_what_to_do(folder: Path, command: str) -> None:
    assert refused(command, "arm_robot.yaml").endswith("expected a scenario, fjr excite arm_robot.yaml writes one")
    (folder / "arm.yaml").write_text("/**: {ros__parameters: {robot: {file: arm_robot.yaml}}}\n")
    assert refused(command, "arm_robot.yaml").endswith("expected a scenario, such as arm.yaml, which names it")


def test_misspelled_names_in_a_robot_file_are_refused(folder: Path) -> None:
    (folder / "arm_robot.yaml").write_text(ROBOT.replace("joint_stiffness", "joint_stifness"))
    (folder / "arm.yaml").write_text("/**: {ros__parameters: {robot: {file: arm_robot.yaml}}}\n")
    (folder / "log.csv").write_text("t\n0\n")
    hint = "unknown parameter 'robot.joint_stifness'; did you mean 'robot.joint_stiffness'?"
    assert hint in refused("check", "arm.yaml")
    assert hint in fjr_here("identify", "log.csv", "--robot", "arm_robot.yaml", code=2)
