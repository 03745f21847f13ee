# SPDX-License-Identifier: Apache-2.0
"""Robot files: search path, precedence of values, guesses, the URDF that describes the robot, and its meshes."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config import parameter, robot_file, ros_yaml
from fjr_core.config.controller import controller_parameters
from fjr_core.config.law import gain_values
from fjr_core.config.law import gains as build_gains
from fjr_core.config.nodes import CONTROLLER, NODES, all_parameters
from fjr_core.config.plant import plant_parameters
from fjr_core.config.robot import description
from fjr_core.config.robot import robot as build_robot
from fjr_core.config.robot_file import inlined, located
from fjr_core.config.scenario import Scenario, load_scenario, parse_scenario, self_contained
from fuzzing import refused
from two_link_urdf import JOINTS, LINK_DAMPING, MOTOR_DAMPING, MOTOR_INERTIA, STIFFNESS, two_link_urdf

ROBOT = f"""
/**:
  ros__parameters:
    joints: {JOINTS}
    robot:
      model: urdf
      urdf: arms/two_link.urdf
      joint_stiffness: {STIFFNESS}
      motor_inertia: {MOTOR_INERTIA}
      link_damping: {LINK_DAMPING}
      motor_damping: {MOTOR_DAMPING}
"""


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Install a package `my_arm` with a robot file and its URDF."""
    share = tmp_path / "install" / "share" / "my_arm"
    (share / "robots" / "arms").mkdir(parents=True)
    (share / "robots" / "two_link.yaml").write_text(ROBOT)
    (share / "robots" / "arms" / "two_link.urdf").write_text(two_link_urdf())
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path / 'install'}")
    return share


def scenario(folder: Path, robot: str, more: str = "") -> Path:
    path = folder / "mine.yaml"
    path.write_text(f"/**:\n  ros__parameters:\n    robot:\n{robot}\n{more}")
    return path


def assert_same_robot(one: fjr.Robot, other: fjr.Robot) -> None:
    for name in ("M_m", "K", "D_l", "D_m", "B_m"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-12)
    q_l = np.linspace(0.3, -0.8, one.n)
    np.testing.assert_allclose(one.M_l(q_l), other.M_l(q_l), rtol=1e-12)
    np.testing.assert_allclose(one.grad_P_l(q_l), other.grad_P_l(q_l), rtol=1e-12)


REFERENCES = {
    "package": "package://my_arm/robots/two_link.yaml",
    "absolute": "{share}/robots/two_link.yaml",
    "relative": "robots/two_link.yaml",
}


@pytest.mark.parametrize("kind", REFERENCES)
def test_robot_file_and_its_relative_urdf_path_are_resolved(workspace: Path, kind: str) -> None:
    path = scenario(workspace, f"      file: {REFERENCES[kind].format(share=workspace)}")
    loaded = load_scenario(path)
    assert loaded.joints == tuple(JOINTS)
    assert loaded.warnings == ()
    assert_same_robot(loaded.robot, fjr.planar_two_link())
    assert_same_robot(loaded.plant.robot, fjr.planar_two_link())


CHANGES = """
    imperfections: {motor_coulomb_friction: [0.01]}
/**/fjr_plant:
  ros__parameters: {imperfections.motor_coulomb_friction: [0.02]}
/**/fjr_controller:
  ros__parameters: {robot.joint_stiffness: [30.0, 20.0]}
"""


def test_scenario_overrides_the_robot_file(workspace: Path) -> None:
    path = scenario(workspace, "      file: robots/two_link.yaml\n      link_damping: [0.5, 0.6]", CHANGES)
    loaded = load_scenario(path)
    np.testing.assert_array_equal(np.diag(loaded.robot.K), [30.0, 20.0])
    np.testing.assert_array_equal(np.diag(loaded.plant.robot.K), STIFFNESS)
    for robot in (loaded.robot, loaded.plant.robot):
        np.testing.assert_array_equal(np.diag(robot.D_l), [0.5, 0.6])


def test_a_self_contained_scenario_needs_no_other_file(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = scenario(workspace, "      file: package://my_arm/robots/two_link.yaml", CHANGES)
    document = ros_yaml.read(path, "scenario")
    given = {node: ros_yaml.values_for(node, document) for node in NODES}
    text = ros_yaml.dump(self_contained(given, path.parent))
    expected = load_scenario(path)
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    (workspace / "robots" / "arms" / "two_link.urdf").unlink()
    alone = parse_scenario("alone", text)
    assert "package://" not in text
    assert alone.warnings == ()
    assert_same_robot(alone.robot, expected.robot)
    assert_same_robot(alone.plant.robot, expected.plant.robot)
    assert text.count("<robot") == 1, "shared parameters must be written once"
    assert alone.plant_values["imperfections.motor_coulomb_friction"] == (0.02,), "the section of the node counts"


BAD_FILES = {
    "missing": ("      file: robots/none.yaml", ["robot.file", "cannot read robot file", "none.yaml"]),
    "unknown package": ("      file: package://nobody/a.yaml", ["robot.file", "'nobody'", "AMENT_PREFIX_PATH"]),
    "no package": ("      file: package:///a.yaml", ["robot.file", "AMENT_PREFIX_PATH"]),
    "gains in it": ("      file: robots/gains.yaml", ["robot.file", "'gains.K_ld'", "expected joints, robot.*"]),
    "names another": ("      file: robots/chain.yaml", ["robot.file", "'robot.file'"]),
    "not YAML": ("      file: robots/arms/two_link.urdf", ["robot.file", "two_link.urdf"]),
    "a folder": ("      file: robots", ["robot.file", "cannot read robot file"]),
    "a number": ("      file: 7", ["robot.file", "7", "expected a string"]),
    "urdf in no package": ("      model: urdf\n      urdf: package://nobody/a.urdf", ["robot.urdf", "'nobody'"]),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_an_invalid_robot_file_is_one_sentence_with_the_parameter(workspace: Path, case: str) -> None:
    robot, words = BAD_FILES[case]
    head = "/**:\n  ros__parameters:\n"
    (workspace / "robots" / "gains.yaml").write_text(f"{head}    gains:\n      K_ld: [1.0]\n")
    (workspace / "robots" / "chain.yaml").write_text(f"{head}    robot:\n      file: two_link.yaml\n")
    refused(fjr.ParameterError, lambda: load_scenario(scenario(workspace, robot)), *words)


def urdf_robot(joints: object = JOINTS, **changes: object) -> fjr.Robot:
    """Return the arm with a wrist whose parameters robot.* differ by the changes; None: not given."""
    elastic = {"joint_stiffness": STIFFNESS, "motor_inertia": MOTOR_INERTIA}
    values = {"model": "urdf", "urdf": two_link_urdf(wrist_mass=0.5), **elastic, **changes}
    named = {"joints": joints, **{f"robot.{name}": value for name, value in values.items()}}
    given = {name: value for name, value in named.items() if value is not None}
    return build_robot(parameter.complete(all_parameters(controller_parameters, given), given))


BAD_VALUES = [
    ({"joints": None}, "'joints' is not given", "urdf"),
    ({"urdf": None}, "robot.urdf", "not given"),
    ({"joint_stiffness": None}, "robot.joint_stiffness", "not given", "N m/rad"),
    ({"motor_inertia": None}, "robot.motor_inertia", "not given"),
    ({"joint_stiffness": [1.0, 2.0, 3.0]}, "robot.joint_stiffness", "length 3", "expected 2", "4"),
    ({"joint_stiffness": [-1.0, 2.0]}, "robot.joint_stiffness", "positive definite"),
    ({"guesses.joint_stiffness": [-1.0, 25.0]}, "robot.guesses.joint_stiffness", "-1.0; expected at least 0"),
    ({"gear_ratio": [100.0]}, "robot.gear_ratio", "length 1", "expected 2"),
    ({"gravity": [0.0, -9.81]}, "robot.gravity", "length 2", "expected 3"),
    ({"gravity": 9.81}, "robot.gravity", "expected a list"),
    ({"locked_joints": ["wrist"], "locked_positions": [0.1, 0.2]}, "robot.locked_positions", "length 2", "expected 1"),
    ({"locked_joints": ["knee"]}, "robot.", "knee"),
    ({"urdf": "<robot"}, "robot.urdf"),
    ({"urdf": "/there/is/no.urdf"}, "robot.urdf", "/there/is/no.urdf"),
]


@pytest.mark.parametrize(("changes", "words"), [(changes, words) for changes, *words in BAD_VALUES])
def test_an_invalid_urdf_robot_is_one_sentence_with_the_parameter(changes: dict[str, object], words: list[str]) -> None:
    refused(fjr.ParameterError, lambda: urdf_robot(**changes), *words)


def test_gear_ratio_and_locked_position_reach_the_robot() -> None:
    np.testing.assert_array_equal(np.diag(urdf_robot().M_m), MOTOR_INERTIA)
    np.testing.assert_allclose(np.diag(urdf_robot(gear_ratio=[10.0, 5.0]).M_m), [2.0, 0.25])
    bent = urdf_robot(locked_joints=["wrist"], locked_positions=[0.9])
    expected = fjr.robot_from_urdf(two_link_urdf(0.5), JOINTS, STIFFNESS, MOTOR_INERTIA, locked={"wrist": 0.9})
    np.testing.assert_allclose(bent.M_l([0.1, 0.2]), expected.M_l([0.1, 0.2]), rtol=1e-12)
    assert np.max(np.abs(bent.M_l([0.1, 0.2]) - urdf_robot().M_l([0.1, 0.2]))) > 1e-3


@pytest.mark.parametrize(("name", "joints"), [("single_link", ["a"]), ("planar_two_link", ["a", "b"])])
def test_parameters_of_closed_form_robots_keep_their_defaults(name: str, joints: list[str]) -> None:
    assert_same_robot(build_robot(values_of(robot__model=name, joints=joints)), getattr(fjr, name)())


def test_gains_are_read_back_from_a_parameter_file() -> None:
    full = [[2.0, 0.3], [0.3, 1.0]]
    gains = fjr.Gains(Lambda_l=[8.0, 9.0], Pi_l=full, K_ld=0.6, Lambda_m=15.0, Pi_m=60.0, K_md=full, Gamma_m=1.0)
    written = ros_yaml.tree_of(gain_values(gains, 2))
    section = {f"/**/{CONTROLLER}": {"ros__parameters": written}}
    given = ros_yaml.values_for(CONTROLLER, ros_yaml.parse(ros_yaml.dump(section)))
    known = controller_parameters(2)
    read = build_gains(parameter.complete(known, given), 2).checked(2)
    for name in ("Lambda_l", "Pi_l", "K_ld", "Lambda_m", "Pi_m", "K_md", "Gamma_l", "Gamma_m"):
        np.testing.assert_array_equal(getattr(read, name), getattr(gains.checked(2), name))


def test_packages_are_searched_in_the_order_of_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for prefix in ("a", "b"):
        (tmp_path / prefix / "share" / "pkg").mkdir(parents=True)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'none'}:{tmp_path / 'b'}:{tmp_path / 'a'}")
    assert robot_file.resolve("package://pkg/x/y.yaml", Path("/")) == tmp_path / "b" / "share" / "pkg" / "x" / "y.yaml"


SCENARIOS = Path(__file__).parents[3] / "ros2_ws" / "src" / "fjr_bringup" / "scenarios"


def values_of(**given: object) -> dict[str, parameter.Value]:
    named = {key.replace("__", "."): value for key, value in given.items()}
    return dict(parameter.complete(all_parameters(plant_parameters, named), named))


ROBOTS = {
    "Table 1": {"robot__model": "single_link"},
    "no gravity": {"robot__model": "single_link", "robot__gravity_torque": [0.0]},
    "upside down": {"robot__model": "single_link", "robot__gravity_torque": [-0.5], "joints": ["a&b"]},
    "heavy": {"robot__model": "single_link", "robot__gravity_torque": [9.0], "robot__link_inertia": [2.0]},
    "two links": {"robot__model": "planar_two_link", "joints": ["shoulder", "elbow"]},
}


@pytest.mark.parametrize("given", ROBOTS.values(), ids=ROBOTS)
def test_generated_description_has_the_same_inertia_and_gravity(given: dict[str, object]) -> None:
    values = values_of(**given)
    closed = build_robot(values)
    read = fjr.robot_from_urdf(description(values), list(values["joints"]), closed.K, closed.M_m)
    rng = np.random.default_rng(0)
    for q_l, dq_l in rng.uniform(-3, 3, (5, 2, closed.n)):
        np.testing.assert_allclose(read.M_l(q_l), closed.M_l(q_l), rtol=1e-12)
        np.testing.assert_allclose(read.grad_P_l(q_l), closed.grad_P_l(q_l), rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(read.coriolis(q_l, dq_l, dq_l), closed.coriolis(q_l, dq_l, dq_l), atol=1e-12)


@pytest.mark.parametrize("name", ["paper_k31", "two_link", "arm7"])
def test_every_link_has_a_visual_and_every_joint_is_present(name: str) -> None:
    """That of an arm from a URDF is this URDF."""
    scenario = load_scenario(SCENARIOS / f"{name}.yaml")
    values = scenario.plant_values
    if name == "arm7":
        assert description(values) == Path(values["robot.urdf"]).read_text(encoding="utf-8")
        assert description(inlined(values)) == description(values)
    robot = ElementTree.fromstring(description(values))
    assert set(scenario.joints) <= {joint.get("name") for joint in robot.iter("joint")}
    turning = {joint.find("child").get("link") for joint in robot.iter("joint") if joint.get("name") in scenario.joints}
    assert turning <= {link.get("name") for link in robot.iter("link") if link.find("visual") is not None}


SCENARIO = """
/**:
  ros__parameters:
    joints: [a, b]
    robot:
      model: planar_two_link
      joint_stiffness: [{stiffness}]
      motor_inertia: [0.02, 0.01]
      {guesses}
    initial_link_position: [0.1, 0.1]
    initial_motor_position: [0.1, 0.1]
    reference: {{type: hold, offset: [0.0, 0.0]}}
"""
BOTH = "guesses: {joint_stiffness: [40.0, 25.0], motor_inertia: [0.0, 0.01]}"


def loaded(stiffness: str = "40.0, 25.0", guesses: str = BOTH) -> Scenario:
    return parse_scenario("mine", SCENARIO.format(stiffness=stiffness, guesses=guesses))


def test_values_that_equal_their_guess_are_counted_until_they_are_replaced() -> None:
    stiffness, inertia = loaded().robot_warnings
    assert stiffness.startswith("joint stiffness of 2 joints is a guess; replace it by a measured or data-sheet value")
    assert inertia.startswith("motor inertia of joint b is a guess")
    for stiffness in ("41.0, 25.0", "41.0, 1.0, 1.0, 25.0"):
        assert "joint stiffness of joint b is a guess" in loaded(stiffness).robot_warnings[0]
    assert loaded("41.0, 26.0", "guesses: {joint_stiffness: [40.0, 25.0]}").robot_warnings == ()
    assert loaded(guesses="").robot_warnings == ()
    assert loaded().robot.fingerprint() == loaded(guesses="").robot.fingerprint()


def urdf(name: str) -> str:
    mesh = f'<mesh filename="{name}" scale="1 1 1"/>'
    return f'<robot><link name="a"><visual><geometry>\n{mesh}\n</geometry></visual></link></robot>'


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package `arm_description` with urdf/ and meshes/link.stl."""
    folder = tmp_path / "arm_description"
    (folder / "meshes").mkdir(parents=True)
    (folder / "urdf").mkdir()
    (folder / "meshes" / "link.stl").touch()
    return folder


@pytest.mark.parametrize("name", ["package://arm_description/meshes/link.stl", "../meshes/link.stl"])
def test_a_mesh_next_to_the_urdf_gets_its_path(package: Path, name: str) -> None:
    (package / "urdf" / "arm.urdf").write_text(urdf(name))
    text = str(inlined({"robot.urdf": str(package / "urdf" / "arm.urdf")})["robot.urdf"])
    path = Path(text.split("file://")[1].split('"')[0])
    assert path.is_absolute()
    assert path.samefile(package / "meshes" / "link.stl")
    assert text.replace(f"file://{path}", name) == urdf(name)
    assert inlined({"robot.urdf": text})["robot.urdf"] == text


@pytest.mark.parametrize("name", ["package://other/meshes/link.stl", "none.stl", "file:///none.stl", "/none.stl", ""])
def test_a_mesh_that_is_elsewhere_stays_as_it_is(package: Path, name: str) -> None:
    assert located(urdf(name), package / "urdf") == urdf(name)
