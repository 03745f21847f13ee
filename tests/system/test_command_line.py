# SPDX-License-Identifier: Apache-2.0
"""The command line of `fjr`: refusals in one sentence before anything is written, help, options, completion."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
from tools.robot_survey import ROBOTS

from fjr_bringup.cli.app import GROUPS, fjr, main
from fjr_msgs_py.console.ending import Exit
from system.executables import fjr_here
from time_limits import HANG
from two_link_urdf import JOINTS, MOTOR_INERTIA, STIFFNESS, two_link_urdf

pytestmark = pytest.mark.system
UR5E = next(robot.urdf for robot in ROBOTS if robot.name == "Universal Robots UR5e")
ROBOT = f"""
/**:
  ros__parameters:
    joints: {JOINTS}
    robot: {{model: urdf, urdf: arm.urdf, joint_stiffness: {STIFFNESS}, motor_inertia: {MOTOR_INERTIA}}}
"""
FILES = {
    "broken.yaml": "/**: {ros__parameters: [not, a, mapping",
    "text.yaml": "{scenario: paper_k31, vary: {stiffness: {uniform: [0.5, 1.5]}}, set: {5: 1}}",
    "empty.yaml": "",
    "alias.yaml": "/**: {ros__parameters: {publish_rate: &rate 500.0, auxiliary_rate: *rate}}",
    "a.csv": "t,u,q\n0,0,0\n",
    "robot.yaml": "/**: {ros__parameters: {joints: [joint1]}}\n",
    "arm.urdf": two_link_urdf(),
    "arm_robot.yaml": ROBOT,
    "map.yaml": "time: {column: t}\nmotor_position: {column: q, unit: rad}\neffort: {column: u, unit: N m}\n",
}
CUBIC = "two_link --set robot.cubic_stiffness:=[4.0e3,2.5e3]"
REFUSED = [
    ("", 2, "Usage: fjr"),
    ("unknown", 2, "No such command 'unknown'"),
    ("run --unknown", 2, "No such option '--unknown'"),
    ("report", 2, "Missing argument 'BAG...'"),
    ("gains arm7", 2, "Missing option '--beta'"),
    ("run", 2, "no scenario given: expected a YAML file or one of arm7, arm7_contact, paper_k31"),
    ("run paper_k99", 2, "unknown scenario 'paper_k99'"),
    ("run --duration nan", 2, "'nan' is not a duration; expected seconds"),
    ("run --duration 3601", 2, "'3601' is not a duration"),
    ("run paper_k31 --set robot.joint_stifness:=[1.0]", 2, "did you mean 'robot.joint_stiffness'"),
    ("run paper_k31 --set publish_rate", 2, "expected name:=value"),
    ("run paper_k31 --set publish_rate:=60.0 --set inner_steps:=200", 1, "unstable as sampled at 60 Hz"),
    ("check alias.yaml", 2, "has a YAML alias (*rate), which ROS 2"),
    ("check empty.yaml", 2, "scenario empty: is empty; expected a ROS 2 parameter file"),
    ("check arm7 --set robot.joint_stiffness:=[1.0]", 2, "'robot.joint_stiffness' has length 1; expected 7"),
    ("check paper_k3p1 --set robust.integral_gain:=[40.0]", 2, "integral_gain is [40.0] 1/s, which makes the loop uns"),
    ("check paper_k31 --error payload=0.1 --error payload=0.2", 2, "'payload' is given 2 times; expected it once"),
    ("check two_link --error stiffness=0.1,0.2,0.3", 2, "'stiffness' is [0.1, 0.2, 0.3]; expected one number or 2"),
    ("check paper_k31 --error payload", 2, "'' is not an error of payload; expected NAME=VALUE with 0 or a posit"),
    ("check paper_k31 --error stiffness=-5%", 2, "'-5%' is not an error of stiffness; expected NAME=VALUE with 0 or "),
    ("check paper_k31 --error link_torque=5%", 2, "'5%' is not an error of link_torque; expected NAME=VALUE with 0"),
    ("check paper_k31 --delay 1 --set robust.residual_gain:=[60.0]", 2, "robust.* is enabled; expected a static law"),
    ("check paper_k31 --set publish_rate:=20.0 --set inner_steps:=1", 1, "inner_steps is 1, too few for rk4"),
    ("check paper_k31 --set imperfections.command_delay:=0.008", 1, "is unstable as sampled at 1000 Hz"),
    ("check paper_k31 --set limits.motor_position_lower:=[0.6]", 1, "q_m is 0.5 rad; expected 0.6 to inf rad"),
    ("check paper_k31 --certificate c.json --set law.type:=lqr", 1, "law.type is 'lqr'; expected 'v_dpbc' for a cert"),
    ("check paper_k31 --certificate a.csv/c.json", 1, "cannot be written"),
    ("check paper_k31 --prove-sampled --set law.type:=lqr", 1, "NOT proven: law.type is lqr; expected v_dpbc"),
    ("check paper_k31 --prove-sampled --set robust.integral_gain:=[1.0]", 1, "robust.* gives the law a state; expe"),
    ("check paper_k31 --prove-sampled --delay 2", 1, "NOT proven: delay is 0 to 2 samples; expected within 0 and 1"),
    (f"check {CUBIC} --prove-error", 2, "expected straight springs for a proof of the sampled loop"),
    ("gains arm7 --beta inf", 2, "'inf' is not a rate; expected a positive number"),
    ("gains paper_k31 --beta 5 --set robust.residual_gain:=[5000.0]", 1, "radius with the scenario's robust.* options"),
    ("gains paper_k31 --beta 5 --write", 2, "is an installed scenario; expected a file of your own for --write"),
    ("excite two_link --output a.csv", 2, "a.csv exists; expected a new file"),
    ("new URDF --joints elbow_joint,elbw_joint", 2, "the URDF has no joint 'elbw_joint'; did you mean 'elbow_"),
    ("new URDF --chain 2", 2, "no chain 2; expected 1 to 1: 1: 6 joints, shoulder_pan_joint to wrist_3_joint"),
    ("new URDF --chain 0", 2, "'0' is not a chain; expected its number, 1 or more"),
    ("new none.urdf", 2, "fjr: URDF none.urdf cannot be read (No such file or directory)"),
    ("new .", 2, "fjr: URDF . cannot be read (Is a directory); expected a file or XML text"),
    ("identify a.csv --robot none.yaml", 2, "cannot read robot file none.yaml (No such file or directory); expected a"),
    ("identify none.csv --robot robot.yaml --map map.yaml", 2, "none.csv is not a table of numbers"),
    ("identify a.csv --robot robot.yaml --accept all", 2, "--accept is 'all'; expected one of too_short, at_rest"),
    ("identify a.csv --map map.yaml", 2, "Missing option '--robot'"),
    ("sweep paper_k31 --runs 1 --output a.csv", 1, "cannot read or write a.csv/paper_k31/parts (Not a directory); exp"),
    ("sweep paper_k31 --duration 0.5", 1, "settle_after is 1.0 s; expected less than --duration, 0.5 s"),
    ("sweep no_such", 2, "or of the sweeps arm7_tune, paper_joint"),
    ("sweep text.yaml", 2, "the name of a parameter is 5; expected text"),
    ("sweep paper_joint --runs 1.5", 2, "'1.5' is not a number of runs; expected 1 or more"),
    ("sweep paper_joint --cores 0", 2, "'0' is not a number of cores; expected 1 or more, or all"),
    (
        "compare nosuite",
        2,
        "unknown suite 'nosuite': expected a YAML file or one of arm7_tuned, paper, paper_tuned, qu",
    ),
    ("compare quick --document nowhere.md", 2, "cannot read nowhere.md"),
    ("compare broken.yaml", 2, "broken.yaml is not valid YAML"),
    ("export-c paper_k31 broken.yaml", 1, "is not a folder"),
    ("export-c paper_k31 /proc/fjr", 1, "cannot write to"),
    ("export-c paper_k31", 2, "DIR"),
    ("echo //bad//", 2, "'//bad//' is not a topic name; expected"),
    ("watch --browser --once", 2, "--browser shows the loop until Ctrl-C; expected it without --once"),
    ("watch --port 9000", 2, "--port is given without --browser"),
    ("watch --browser --port 70000", 2, "expected 0 to 65535"),
    ("watch --remap a:=", 2, "'a:=' is not a remap; expected FROM:=TO"),
    ("watch --namespace 'a b'", 2, "'a b' is not a ROS name; expected letters"),
    ("watch --controller 1st", 2, "'1st' is not a ROS name"),
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize(("line", "code", "words"), REFUSED, ids=[line for line, *_ in REFUSED])
def test_what_cannot_be_done_is_refused_in_one_sentence(folder: Path, line: str, code: int, words: str) -> None:
    said = fjr_here(*shlex.split(line.replace("URDF", str(UR5E))), code=code)
    assert words in said
    assert "Traceback" not in said
    assert {path.name for path in folder.iterdir()} == {*FILES}


OF_SCENARIOS = {
    **{name: (name, "FILE") for name in ("run", "check", "excite", "description", "sweep", "tune")},
    "gains": ("gains", "FILE", "--beta", "1"),
    "export-c": ("export-c", "FILE", "exported"),
    "export-ros2-control": ("export-ros2-control", "FILE", "exported"),
    "watch": ("watch", "FILE", "--once"),
}
COMMANDS = {
    **OF_SCENARIOS,
    **{name: (name, "FILE") for name in ("new", "report", "compare", "play")},
    "export-mjcf": ("export-mjcf", "FILE", "made.xml"),
    "identify, robot": ("identify", "a.csv", "--robot", "FILE"),
    "identify, record": ("identify", "FILE", "--robot", "robot.yaml", "--map", "map.yaml"),
    "identify, map": ("identify", "a.csv", "--robot", "robot.yaml", "--map", "FILE"),
}
LOOPS = ("run", "check", "export-c", "export-ros2-control", "sweep", "tune")
"""Commands that need motion and gains."""


def refused(command: str, file: str) -> str:
    """Return what a command says that refuses a file."""
    said = fjr_here(*(file if word == "FILE" else word for word in COMMANDS[command]), code=2)
    assert "fjr: " in said or "Error" in said
    assert "Traceback" not in said
    return said


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_that_is_missing_empty_or_binary_is_refused(folder: Path, command: str) -> None:
    (folder / "binary.csv").write_bytes(bytes(range(256)))
    for file in ("missing.yaml", "empty.yaml", "binary.csv"):
        refused(command, file)


@pytest.mark.parametrize("command", OF_SCENARIOS)
def test_a_urdf_or_robot_file_in_place_of_a_scenario_names_what_to_do(folder: Path, command: str) -> None:
    assert "expected a scenario: fjr new arm.urdf writes one" in refused(command, "arm.urdf")
    if command in LOOPS:
        assert "expected a scenario, fjr excite arm_robot.yaml writes one" in refused(command, "arm_robot.yaml")
        if command == "run":
            assert "is a robot file" in fjr_here("run", "arm_robot.yaml", "--lockstep", "--engine", "own", code=2)
        (folder / "arm.yaml").write_text("/**: {ros__parameters: {robot: {file: arm_robot.yaml}}}\n")
        assert "expected a scenario, such as arm.yaml, which names it" in refused(command, "arm_robot.yaml")


def test_names_in_a_robot_file_that_nothing_reads_are_refused(folder: Path) -> None:
    file = folder / "mine.yaml"
    (folder / "arm_robot.yaml").write_text(ROBOT.replace("joint_stiffness", "joint_stifness"))
    file.write_text("/**: {ros__parameters: {robot: {file: arm_robot.yaml}}}\n")
    hint = "unknown parameter 'robot.joint_stifness'; did you mean 'robot.joint_stiffness'?"
    assert hint in refused("check", "mine.yaml")
    assert hint in refused("identify, robot", "arm_robot.yaml")


# Help without slow imports, options that need no value, completion.


SLOW = ("numpy", "casadi", "rclpy", "matplotlib", "scipy", "pyarrow")


def given(*words: str) -> dict[str, object]:
    """Return the parameters that a command is called with."""
    command = fjr.commands[words[0]]
    return dict(command.make_context(words[0], list(words[1:]), obj=lambda: None).params)


def test_help_scenarios_and_usage_errors_import_nothing_slow() -> None:
    lines = ("--help", "--version", "run --help", "run --duration no", "scenarios", "scenarios --json")
    code = f"import sys; from fjr_bringup.cli.app import main\nfor line in {lines!r}:\n    main(line.split()); "
    code += f"print('loaded:', *sorted(set({SLOW!r}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=HANG, check=True)
    loaded = [line for line in done.stdout.splitlines() if line.startswith("loaded:")]
    assert loaded == ["loaded:"] * len(lines)


def test_the_help_has_ten_commands_in_three_groups_and_all_on_request(capsys: pytest.CaptureFixture[str]) -> None:
    assert [*GROUPS] == ["Run", "Your robot", "Studies"]
    assert sum(map(len, GROUPS.values())) <= 10
    assert main(["--help"]) == Exit.DONE
    short = listed(capsys.readouterr().out)
    assert short == [name for names in GROUPS.values() for name in names]
    assert main(["help", "all"]) == Exit.DONE
    assert set(listed(capsys.readouterr().out)) == {name for name, each in fjr.commands.items() if not each.hidden}
    assert main(["help", "run"]) == Exit.DONE
    assert capsys.readouterr().out.startswith("Usage: fjr run [OPTIONS]")
    assert main(["help", "nothing"]) == Exit.NOT_UNDERSTOOD
    assert main(["--version"]) == Exit.DONE
    assert capsys.readouterr().out == "fjr 0.1.0\n"
    for command in fjr.commands.values():
        assert command.help
        assert "..." not in command.get_short_help_str(61)
        assert all(each.help for each in command.params if isinstance(each, click.Option))


def listed(text: str) -> list[str]:
    """Return the commands that a help lists."""
    return [name for name in re.findall(r"^  ([a-z][a-z0-9-]*)  ", text, re.MULTILINE) if name in fjr.commands]


def test_a_reader_that_ends_early_ends_the_command_quietly() -> None:
    read, write = os.pipe()
    os.close(read)
    code = "import sys; from fjr_bringup.cli.app import main; sys.exit(main(['scenarios']))"
    done = subprocess.run([sys.executable, "-c", code], stdout=write, stderr=subprocess.PIPE, text=True, timeout=HANG)
    os.close(write)
    assert (done.returncode, done.stderr) == (Exit.FAILED, "")


def test_options_with_an_optional_value() -> None:
    assert str(given("compare", "--document")["document"]) == "docs/tables/compare.md"
    assert str(given("compare", "quick", "--document", "other.md")["document"]) == "other.md"
    assert given("compare")["document"] is None
    assert given("compare")["suite"] == "paper"
    assert given("echo", "/t")["count"] is None
    assert given("echo", "/t", "--once")["count"] == 1
    assert given("echo", "/t", "--count", "3")["count"] == 3
    assert given("sweep", "--runs", "1e4")["runs"] == 10_000
    assert given("sweep", "--cores", "all")["cores"] == len(os.sched_getaffinity(0))


def test_the_shell_completes_commands_scenarios_and_parameters(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_FJR_COMPLETE", "bash_complete")
    for line, expected in (
        ("fjr export-c", "export-c"),
        ("fjr run paper_k31", "paper_k31"),
        ("fjr run two_link --set lockstep_t", "lockstep_timeout:="),
        ("fjr check arm7 --set limits.start_err", "limits.start_error:="),
    ):
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(len(line.split()) - 1))
        with pytest.raises(SystemExit):
            main(line.split()[1:])
        assert capsys.readouterr().out == f"plain,{expected}\n"
