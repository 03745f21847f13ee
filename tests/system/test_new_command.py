# SPDX-License-Identifier: Apache-2.0
"""`fjr new` makes files from URDFs that `fjr check` accepts and `fjr run` tracks; guesses are reported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tools.robot_survey import ROBOTS

from fjr_core.config import ros_yaml
from fjr_core.config.nodes import CONTROLLER
from fjr_core.config.scenario import load_scenario
from fjr_core.errors import ParameterError, RobotError
from fjr_core.urdf.typical_joints import joints_without_inertia
from fjr_design.scaffold.arm import arm_of, published
from fjr_msgs_py.scenarios import library
from fjr_msgs_py.scenarios.gains_block import with_gains
from system.executables import fjr_here, fjr_json, scenario
from two_link_urdf import joint, two_link_urdf

pytestmark = pytest.mark.system

UR5E = next(robot.urdf for robot in ROBOTS if robot.name == "Universal Robots UR5e")
GUESS = "joint stiffness of {} is a guess"


def rtb(name: str) -> Path:
    return next(robot.urdf for robot in ROBOTS if robot.name == name)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the files that `fjr new` makes of two joints of a UR5e."""
    folder = tmp_path_factory.mktemp("new")
    said = fjr_here(
        "new", str(UR5E), "--joints", "shoulder_lift_joint,elbow_joint", "--name", "arm", "--output", str(folder)
    )
    assert "locked     shoulder_pan_joint, wrist_1_joint, wrist_2_joint, wrist_3_joint, at 0" in said
    assert "motion     0.2 rad at most, at 0.5 Hz" in said
    return folder


@pytest.mark.usefixtures("no_picture")
def test_the_files_are_accepted_and_the_report_of_a_run_repeats_the_guesses(made: Path) -> None:
    said = fjr_json("check", str(made / "arm.yaml"))
    assert said["stable"]
    assert said["warnings"][0].startswith(GUESS.format("2 joints"))
    assert said["rows"]["reference"] == "within the position limits; within the velocity limits"
    assert said["rows"]["first effort"].endswith("within the effort limits")
    assert said["rows"]["initial position"] == "within the ranges of the joints"
    output = made / "runs"
    options = ("--lockstep", "--duration", "0.1", "--set", "compile:=false", "--output", str(output))
    shown = fjr_here("run", str(made / "arm.yaml"), *options)
    report = json.loads((output / "arm" / "report.json").read_text(encoding="utf-8"))
    assert report["stop"] is None
    for sentence in report["guesses"]:
        assert f"fjr: {sentence}" in shown
        assert sentence[1:] in (output / "arm" / "report.html").read_text(encoding="utf-8")
    assert report["guesses"][0].startswith(GUESS.format("2 joints"))


def test_the_arm_tracks_and_its_files_are_replaced_only_on_request(made: Path) -> None:
    again = ("new", str(UR5E), "--joints", "elbow_joint", "--name", "arm", "--output", str(made))
    assert "arm_robot.yaml exists; expected a new file" in fjr_here(*again, code=2)
    loop = load_scenario(made / "arm.yaml")
    run = loop.simulate(2.2)
    late, n = run.t >= 2.0, loop.robot.n
    assert np.abs(run.x[late, :n] - run.jets[late, 0]).max() < 1e-4
    assert np.all(np.abs(run.u).max(axis=0) < 0.8 * loop.robot.limits.effort)
    deflection = np.abs(run.x[:, n : 2 * n] - run.x[:, :n]).max(axis=0)
    limit = np.asarray(loop.controller_values["limits.deflection"])
    assert np.all(deflection < 0.4 * limit)
    assert np.all(limit < 2 * np.pi / 100)  # a turn of a motor before the gear


def test_joints_that_a_urdf_locks_and_the_priority_are_written(tmp_path: Path) -> None:
    text = two_link_urdf(wrist_mass=0.3).replace('<joint name="wrist"', '<joint name="gripper"')
    (tmp_path / "my arm.urdf").write_text(text.replace('upper="3"', 'upper="3"', 1), encoding="utf-8")
    fjr_here("new", str(tmp_path / "my arm.urdf"), "--output", str(tmp_path))
    values = load_scenario(tmp_path / "my_arm.yaml").controller_values
    assert values["joints"] == ("shoulder", "elbow")
    assert values["realtime_priority"] == 50
    assert "# Locked: gripper, at 0" in (tmp_path / "my_arm_robot.yaml").read_text(encoding="utf-8")


# Choices, without the synthesis of gains.


def test_real_arms_have_one_chain_of_six_joints_and_one_without_inertia_is_refused() -> None:
    for name in ("KUKA KR 16-2", "KUKA KR 210", "Universal Robots UR3e"):
        arm = arm_of(rtb(name))
        assert (len(arm.joints), len(arm.chains), len(arm.guesses["joint_stiffness"])) == (6, 1, 6)
        assert joints_without_inertia(arm.robot) == {}
    with pytest.raises(RobotError, match="no link that joint 'joint_a1' moves has an inertia; expected some"):
        arm_of(rtb("KUKA LBR iiwa 14"))


def test_where_all_joints_are_those_of_a_hand_they_are_named_and_taken_on_request(tmp_path: Path) -> None:
    (tmp_path / "finger.urdf").write_text(two_link_urdf().replace('joint name="', 'joint name="finger_'), "utf-8")
    with pytest.raises(RobotError, match="expected an arm, or --joints finger_shoulder,finger_elbow$"):
        arm_of(tmp_path / "finger.urdf")
    assert arm_of(tmp_path / "finger.urdf", ["finger_shoulder", "finger_elbow"]).robot.n == 2


def test_joints_that_carry_no_mass_are_locked_with_a_note(tmp_path: Path) -> None:
    flange = '<link name="flange"/>' + joint("roll", "lower", "flange", -0.25)
    (tmp_path / "arm.urdf").write_text(two_link_urdf().replace("</robot>", flange + "</robot>"), encoding="utf-8")
    arm = arm_of(tmp_path / "arm.urdf")
    assert arm.joints == ("shoulder", "elbow")
    assert arm.notes == ("no link beyond elbow has an inertia: roll locked",)


def test_friction_and_gear_ratios_that_are_not_read_are_noted(tmp_path: Path) -> None:
    given = '<dynamics damping="{0}" friction="0.0"/><{1}>{2}</{1}><!-- <dynamics damping="0.5"/> --></joint>'
    notes, old, new = [], "mechanicalReduction", "mechanical_reduction"
    for numbers in (("0.0", old, " 1.0 "), ("0.7", new, "1"), ("0", old, "100"), ("0", new, " 100")):
        (tmp_path / "arm.urdf").write_text(two_link_urdf().replace("</joint>", given.format(*numbers)))
        notes.append([note.split()[0] for note in arm_of(tmp_path / "arm.urdf").notes])
    assert notes == [[], ["<dynamics>"], *[["<transmission>"]] * 2]


@pytest.mark.parametrize("element", ['<safety_controller soft_upper_limit="1"/>', '<rotor_inertia value="1e-4"/>'])
def test_soft_limits_and_rotors_that_are_not_read_are_noted(element: str, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(two_link_urdf().replace("</joint>", element + "</joint>"))
    (note,) = arm_of(tmp_path / "arm.urdf").notes
    assert note.startswith(f"{element.split()[0]}> is not read: enter ")


def test_a_name_that_is_changed_is_said(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(two_link_urdf())
    said = fjr_here("new", str(tmp_path / "arm.urdf"), "--name", "mein Ärmel", "--output", str(tmp_path))
    assert "name       mein_rmel, for 'mein Ärmel'" in said


THIN = '<inertia ixx="1e-06" ixy="0" ixz="0" iyy="1e-06" iyz="0" izz="1e-06"/>'


def with_thin_hand(folder: Path) -> Path:
    """Return a URDF whose last link has a mass on the axis of its joint, and an inertia that is a placeholder."""
    hand = f'<link name="hand"><inertial><mass value="150"/><origin xyz="0 0 -0.2"/>{THIN}</inertial></link>'
    roll = joint("roll", "lower", "hand", -0.25).replace('axis xyz="0 1 0"', 'axis xyz="0 0 1"')
    file = folder / "arm.urdf"
    file.write_text(two_link_urdf().replace("</robot>", hand + roll + "</robot>"), encoding="utf-8")
    return file


def test_a_joint_whose_links_lack_inertia_is_locked_with_a_note_and_named_where_a_robot_file_moves_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, thin = arm_of(with_thin_hand(tmp_path)), "roll turns 150 kg with an inertia of 1e-06 kg m^2"
    assert arm.joints == ("shoulder", "elbow")
    assert arm.notes == (f"{thin}, which no real link has: roll locked, until the URDF has it",)
    assert len(arm.guesses["joint_stiffness"]) == 2
    with pytest.raises(RobotError, match="roll turns 150 kg .*; expected the inertia of its links in the URDF, or "):
        arm_of(arm.urdf, joints=("shoulder", "elbow", "roll"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.yaml").write_text(
        "/**: {ros__parameters: {joints: [shoulder, elbow, roll], robot: {model: urdf, urdf: arm.urdf,"
        " joint_stiffness: [100.0, 50.0, 10.0], motor_inertia: [0.1, 0.1, 0.1]}}}"
    )
    assert f"fjr: robot.yaml: {thin}" in fjr_here("identify", "none.csv", "--robot", "robot.yaml", code=2)
    (warning,) = library.load("robot.yaml", robot_only=True).robot_warnings
    assert warning.startswith(thin)


def test_paths_in_a_robot_file_are_relative_and_hold_when_both_are_moved(tmp_path: Path) -> None:
    (tmp_path / "a" / "urdf").mkdir(parents=True)
    (tmp_path / "a" / "urdf" / "arm.urdf").write_text(two_link_urdf())
    fjr_here("new", str(tmp_path / "a" / "urdf" / "arm.urdf"), "--output", str(tmp_path / "a" / "mine"))
    assert "urdf: ../urdf/arm.urdf" in (tmp_path / "a" / "mine" / "arm_robot.yaml").read_text()
    (tmp_path / "a").rename(tmp_path / "b")
    assert library.load(str(tmp_path / "b" / "mine" / "arm.yaml")).joints == ("shoulder", "elbow")


def test_a_locked_joint_stays_within_its_range(tmp_path: Path) -> None:
    wrist = two_link_urdf(wrist_mass=0.3)
    start = wrist.index('<joint name="wrist"')
    (tmp_path / "arm.urdf").write_text(wrist[:start] + wrist[start:].replace('lower="-3"', 'lower="0.2"'))
    arm = arm_of(tmp_path / "arm.urdf", joints=("shoulder", "elbow"))
    assert arm.locked == {"wrist": 0.2}


def test_published_data_replace_guesses() -> None:
    data = published(("panda_joint2", "panda_joint1"))
    assert data["motor_inertia"][data["joints"].index("panda_joint1")] == 0.605721456
    assert "Drake" in data["source"]
    assert published(("panda_joint1", "joint9")) == {}


# `fjr gains --write` replaces the gains in a scenario's file and leaves every other character of it.


GAINS = {"Lambda_l": [9.0, 9.0], "K_ld": [1.0, 0.5, 0.5, 2.0]}
NEW = "      Lambda_l: [9.0, 9.0]\n      K_ld: [1.0, 0.5,\n             0.5, 2.0]"
HEAD = """# My arm.
/**:
  ros__parameters:
    robot: {file: "package://fjr_bringup/robots/two_link.yaml"}   # the robot
"""
BLOCK = """    gains:   # tuned on Monday
      Lambda_l: [1.0, 1.0]   # 1/s
      # the old link damping
      Gamma_l: [0.1, 0.1]
    law: {type: v_dpbc}
"""
REPLACED = BLOCK.replace("[1.0, 1.0]", "[9.0, 9.0]").replace("      Gamma_l: [0.1, 0.1]", NEW.partition("\n")[2])
OWN = HEAD + "/**/fjr_controller:\n  ros__parameters:\n    gains:\n"
CASES = {
    "replaced": (HEAD + BLOCK, HEAD + REPLACED),
    "new block": (HEAD, HEAD.replace("    robot:", f"    gains:\n{NEW}\n    robot:")),
    "flow": (HEAD + "    gains: {Lambda_l: [1.0, 1.0]}   # short\n", HEAD + f"    gains: \n{NEW}   # short\n"),
    "own section": (OWN + "      Lambda_l: [1.0, 1.0]", OWN + NEW + "\n"),
}


@pytest.mark.parametrize("case", CASES)
def test_everything_but_the_gains_stays(case: str) -> None:
    before, after = CASES[case]
    assert with_gains(before, GAINS, 2) == after


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + "    gains.Lambda_l: [1.0, 1.0]\n", "expected one block `gains:`"),
        ("/**: {ros__parameters: {joints: [a, b]}}\n", "no block `ros__parameters:` for the controller"),
        ("/**/fjr_plant:\n  ros__parameters: {}\n", "no block `ros__parameters:` for the controller"),
        (HEAD + BLOCK + "/**/fjr_controller:\n  ros__parameters:\n    gains.K_ld: [1.0, 1.0]\n", "expected one block"),
    ],
)
def test_a_file_without_a_place_for_gains_is_refused(text: str, said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        with_gains(text, GAINS, 2)


def test_the_written_gains_are_those_that_are_printed_and_load(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    text = Path(scenario("two_link")).read_text(encoding="utf-8")
    path.write_text(text, encoding="utf-8")
    said = fjr_here("gains", str(path), "--beta", "5", "--write")
    assert f"# written to {path}:" in said
    gains = ros_yaml.parse(said[said.index("    gains:") :])["gains"]
    values = ros_yaml.values_for(CONTROLLER, ros_yaml.parse(path.read_text(encoding="utf-8")))
    assert {name: values[f"gains.{name}"] for name in gains} == gains
    comments = [line.partition("#")[2] for line in text.splitlines() if "#" in line]
    assert [line.partition("#")[2] for line in path.read_text(encoding="utf-8").splitlines() if "#" in line] == comments
    assert load_scenario(path).law.rate().beta >= 5
