# SPDX-License-Identifier: Apache-2.0
"""What `fjr check`, `gains`, `new`, `sweep`, `compare` and the exports cannot do is refused in one sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
from tools.robot_survey import ROBOTS

from system.executables import fjr_here

pytestmark = pytest.mark.system
UR5E = next(robot.urdf for robot in ROBOTS if robot.name == "Universal Robots UR5e")
REFUSED = [
    ("check", 2, "no scenario given"),
    ("check paper_k31 --set robot.file:=none.yaml", 2, "parameter 'robot.file': cannot read robot file"),
    ("check arm7 --set robot.joint_stiffness:=[1.0]", 2, "'robot.joint_stiffness' has 1 entries; expected 7"),
    (
        "check paper_k3p1 --set robust.integral_gain:=[40.0]",
        2,
        "integral_gain is [40] 1/s, which makes the loop unstable at a hold of 0.001 s; expected at most [2",
    ),
    ("check paper_k31 --error mass=0.2", 2, "error 'mass' is unknown; expected some of payload, payload_mass"),
    (
        "check paper_k31 --error payload=0.1 --error payload=0.2",
        2,
        "error 'payload' is given 2 times; expected it once",
    ),
    ("check paper_k31 --error payload", 2, "'' is not an error; expected NAME=VALUE with 0 or a positive number"),
    (
        "check paper_k31 --delay 1 --set robust.residual_gain:=[60.0]",
        2,
        "robust.* is enabled; expected a static law",
    ),
    ("check paper_k31 --set publish_rate:=20.0 --set inner_steps:=1", 1, "inner_steps is 1, too few for rk4"),
    ("check paper_k31 --set imperfections.command_delay:=0.008", 1, "is unstable as sampled at 1000 Hz"),
    (
        "gains paper_k31 --beta 5 --set robust.residual_gain:=[5000.0]",
        1,
        "the spectral radius with the scenario's robust.* options and observer is",
    ),
    (
        "gains paper_k31 --beta 5 --write",
        2,
        "'paper_k31' is an installed scenario; expected a file of your own for --write",
    ),
    (
        "new URDF --joints elbow_joint,elbw_joint",
        2,
        "ur5e.urdf: the URDF has no joint 'elbw_joint'; did you mean 'elbow_",
    ),
    ("new URDF --chain 2", 2, "no chain 2; expected 1 to 1: 1: 6 joints, shoulder_pan_joint to wrist_3_joint"),
    ("new URDF --chain 0", 2, "'0' is not a chain; expected its number, 1 or more"),
    ("new none.urdf", 2, "cannot be read (No such file or directory)"),
    ("sweep no_such", 2, "or of the sweeps arm7_tune, paper_joint"),
    ("sweep text.yaml", 2, "the name of a parameter is 5; expected text"),
    ("sweep paper_joint --scheduler nowhere", 1, "address is 'nowhere'; expected e.g. tcp://"),
    (
        "compare nosuite",
        2,
        "unknown suite 'nosuite': expected a YAML file or one of arm7_tuned, paper, paper_tuned, quick",
    ),
    ("compare quick --document nowhere.md", 2, "cannot read nowhere.md"),
    ("compare broken.yaml", 2, "broken.yaml is not valid YAML"),
    ("export-c paper_k99 DIR", 2, "unknown scenario"),
    ("export-c paper_k31 DIR --set gains.K_ld:=[-1.0]", 2, "positive definite"),
    ("export-c broken.yaml DIR", 2, "broken"),
    ("export-c paper_k31 DIR --prefix 7a", 2, "expected a letter"),
    ("export-c paper_k31 broken.yaml", 1, "is not a folder"),
    ("export-c paper_k31 broken.yaml/below", 1, "cannot write to"),
    ("export-c paper_k31 /proc/fjr", 1, "cannot write to"),
    ("export-c paper_k31", 2, "DIR"),
    ("export-ros2-control two_link DIR --package My-Arm", 2, "expected a lower-case letter"),
    ("export-ros2-control two_link broken.yaml", 1, "is not a folder"),
]


@pytest.mark.parametrize(("line", "code", "words"), REFUSED, ids=[line for line, *_ in REFUSED])
def test_what_cannot_be_done_is_refused_in_one_sentence(
    line: str, code: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.yaml").write_text("/**: {ros__parameters: [not, a, mapping")
    (tmp_path / "text.yaml").write_text("{scenario: paper_k31, vary: {stiffness: {uniform: [0.5, 1.5]}}, set: {5: 1}}")
    said = fjr_here(*line.replace("URDF", str(UR5E)).split(), code=code)
    assert words in said
    assert "Traceback" not in said
    assert not (tmp_path / "DIR").exists()
    assert not (tmp_path / "runs" / "compare_quick").exists()
