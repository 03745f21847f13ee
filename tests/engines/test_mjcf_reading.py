# SPDX-License-Identifier: Apache-2.0
"""`fjr new` reads an MJCF as MuJoCo does; what is not a serial arm of elastic joints is refused in one sentence."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from fjr_core.errors import PIP, RobotError
from fjr_design.scaffold.arm import Arm, arm_of
from fjr_engines.mjcf.reading import read_mjcf
from system.executables import fjr_here

ARM = """<mujoco model="lab">
  <compiler angle="degree" eulerseq="zyx"/>
  <option gravity="1 -2 -9"/>
  <default><joint armature="0.05"/><default class="wrist"><joint axis="1 2 0" damping="3"/></default></default>
  <worldbody>
    <body name="stand" pos="0.1 0 0.5" euler="20 -30 40">
      <geom type="box" size="0.1 0.1 0.2" density="700"/>
      <body name="upper" pos="0 0.1 0.2" euler="0 90 0">
        <joint name="shoulder" axis="0 1 1" pos="0.02 -0.03 0.05" ref="25" range="-80 120"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0.1" size="0.04"/>
        <body name="fore" pos="0.3 0 0" quat="0.5 0.5 -0.5 0.5">
          <joint name="roll" class="wrist" pos="0 0.05 0"/>
          <joint name="pitch" class="wrist" axis="0 0 1" pos="0.01 0 -0.02" armature="0"/>
          <geom type="cylinder" size="0.03 0.1" euler="10 20 30" pos="0 0 0.1"/>
          <frame pos="0.05 0 0" euler="0 45 0">
            <body name="tool" pos="0 0 0.1">
              <joint name="slide" type="slide" axis="0 1 0" ref="0.1" range="-0.2 0.2"/>
              <inertial pos="0.01 0.02 0.03" mass="2" fullinertia="0.02 0.03 0.04 0.001 -0.002 0.003"/>
              <body pos="0 0 0.2"><geom type="sphere" size="0.05" mass="0.5"/></body>
            </body>
          </frame>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="shoulder" gear="50" ctrlrange="-2 2"/>
    <position joint="roll" kp="100" forcerange="-30 40" armature="0.001" gear="10"/>
    <motor joint="pitch"/>
  </actuator>
</mujoco>"""
JOINTS = ("shoulder", "roll", "pitch", "slide")


def arm_from(text: str, folder: Path, *joints: str) -> Arm:
    (folder / "lab.xml").write_text(text, encoding="utf-8")
    urdf, known = read_mjcf(folder / "lab.xml", folder)
    return arm_of(folder / "lab.urdf", joints, text=urdf, known=known)


def test_inertia_and_weight_are_those_of_mujoco(tmp_path: Path) -> None:
    """Anchors, references, frames, classes, orientations, several joints on a body, inertia from shapes."""
    arm = arm_from(ARM, tmp_path)
    assert arm.joints == JOINTS
    model = mujoco.MjModel.from_xml_string(ARM)
    data, inertia = mujoco.MjData(model), np.zeros((4, 4))
    for q in np.random.default_rng(5).uniform(-1.5, 1.5, (20, 4)):
        data.qpos, data.qvel = q, 0.0
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
        reflected = np.diag(model.dof_armature + [0.0, 0.1, 0.0, 0.0])
        assert arm.robot.M_l(q) == pytest.approx(inertia - reflected, rel=1e-9, abs=1e-12)
        assert arm.robot.grad_P_l(q) == pytest.approx(data.qfrc_bias, rel=1e-9, abs=1e-9)


def test_motors_and_limits_are_read_and_what_is_not_known_is_a_guess(tmp_path: Path) -> None:
    arm = arm_from(ARM, tmp_path)
    assert np.diag(arm.robot.M_m)[[0, 1, 3]] == pytest.approx([0.05, 0.05 + 0.001 * 10**2, 0.05])
    assert [bool(guess) for guess in arm.guesses["motor_inertia"]] == [False, False, True, False]
    assert all(arm.guesses["joint_stiffness"])
    assert arm.source == "lab.xml"
    assert arm_from(body(TWO), tmp_path).source == ""
    limits = arm.robot.limits
    assert limits.lower == pytest.approx([np.deg2rad(-80.0), -np.inf, -np.inf, -0.2])
    assert limits.upper == pytest.approx([np.deg2rad(120.0), np.inf, np.inf, 0.2])
    assert limits.effort == pytest.approx([100.0, 300.0, np.inf, np.inf])


LIMITED: dict[str, tuple[str, list[float]]] = {
    "the tighter of force and control": (
        '<motor joint="one" gear="-50" ctrlrange="-2 2" forcerange="-9 9"/>'
        '<motor joint="two" gear="2" ctrlrange="-2 2" forcerange="-1 1"/>',
        [100.0, 2.0],
    ),
    "of two motors at one joint": (
        '<motor joint="one" gear="2" ctrlrange="-2 2"/><general joint="one" gainprm="30" ctrlrange="-1 1"/>'
        '<motor joint="two" ctrlrange="-3 3"/>',
        [34.0, 3.0],
    ),
    "of a motor that only pulls": ('<motor joint="one" gear="50" ctrlrange="0 2"/>', [100.0, np.inf]),
}


@pytest.mark.parametrize(("motors", "expected"), LIMITED.values(), ids=LIMITED)
def test_the_limit_of_an_effort_is_the_largest_that_mujoco_lets_act(
    motors: str, expected: list[float], tmp_path: Path
) -> None:
    text = body(TWO, f"<actuator>{motors}</actuator>")
    limits = arm_from(text, tmp_path).robot.limits
    assert limits is not None
    assert limits.effort == pytest.approx(expected)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    efforts = []
    for data.ctrl[:] in (-1e3, 1e3):
        mujoco.mj_forward(model, data)
        efforts.append(np.abs(data.qfrc_actuator))
    moved = np.isfinite(expected)
    assert np.max(efforts, axis=0)[moved] == pytest.approx(np.array(expected)[moved])


def test_damping_and_friction_of_a_joint_are_said_not_to_be_read(tmp_path: Path) -> None:
    for text, count in ((TWO, 0), (TWO.replace("axis", 'damping="3" axis'), 1)):
        notes = arm_from(body(text), tmp_path).notes
        assert sum("<dynamics> is not read: enter damping as motor_damping" in note for note in notes) == count


FEEDBACK = "feedback of actuators (position, velocity, muscles)"


def actuator(element: str) -> str:
    return f"<actuator>{element}</actuator>"


ACTING = {
    "a spring of a joint": ("stiffness of joints", "two", 'stiffness="5" springref="10" axis', ""),
    "one that hardens only": ("stiffness of joints", "two", 'stiffness="0 3" axis', ""),
    "damping that grows": ("damping of joints that is not linear", "two", 'damping="0 2" axis', ""),
    "gravity that is compensated": ("gravcomp of bodies", "two", "axis", ""),
    "a position servo": (FEEDBACK, "two", "axis", actuator('<position joint="two" kp="9"/>')),
    "a velocity servo": (FEEDBACK, "two", "axis", actuator('<velocity joint="two" kv="9"/>')),
    "a servo whose set point is integrated": (
        f"dynamics of actuators (filters, integrators, muscles), {FEEDBACK}",
        "two",
        "axis",
        actuator('<intvelocity joint="two" kp="9"/>'),
    ),
    "a controller of a plugin": (
        "plugins",
        "two",
        "axis",
        '<extension><plugin plugin="mujoco.pid"><instance name="pid"><config key="kp" value="9"/></instance></plugin>'
        "</extension>" + actuator('<plugin joint="two" plugin="mujoco.pid" instance="pid"/>'),
    ),
    "an elastic strip between the base and a link": (
        "deformable bodies (flex)",
        "two",
        "axis",
        '<deformable><flex name="strip" dim="1" body="world b" vertex="0.3 0 0 0.1 0 0.1" element="0 1" radius="0.01">'
        '<contact contype="0" conaffinity="0"/><edge stiffness="50" damping="2"/></flex></deformable>',
    ),
    "air": ("drag (density, viscosity)", "two", "axis", '<option density="500" viscosity="0.3"/>'),
}


@pytest.mark.parametrize(("says", "joint", "attributes", "more"), ACTING.values(), ids=ACTING)
def test_what_acts_in_mujoco_beyond_the_rigid_arm_is_said_not_to_be_read(
    says: str, joint: str, attributes: str, more: str, tmp_path: Path
) -> None:
    """Accelerations of MuJoCo are those of the arm without it, and others with it."""
    plain = body(TWO)
    text = body(TWO.replace("axis", attributes), more)
    text = text.replace('name="b"', 'name="b" gravcomp="1"') if "gravcomp" in says else text
    q, v, found = [0.3, -0.5], [1.0, -2.0], []
    for mjcf in (plain, text):
        model = mujoco.MjModel.from_xml_string(mjcf)
        data = mujoco.MjData(model)
        data.qpos, data.qvel = q, v
        mujoco.mj_forward(model, data)
        found.append(data.qacc.copy())
    arm = arm_from(plain, tmp_path)
    rigid = np.linalg.solve(arm.robot.M_l(q), -arm.robot.links.inertial_torque(q, v, v, np.zeros(2)).full().ravel())
    assert found[0] == pytest.approx(rigid - np.linalg.solve(arm.robot.M_l(q), arm.robot.grad_P_l(q)), rel=1e-9)
    assert np.abs(found[1] - found[0]).max() > 0.01
    assert not any("not read" in note for note in arm.notes)
    assert f"not read, though they act in MuJoCo: {says}" in arm_from(text, tmp_path).notes


SITES = '<site name="tip" pos="0.1 0 0.3"/><site name="rail" pos="0.3 0 0" zaxis="1 0 0"/>'
ELSEWHERE = {
    "a thruster": '<motor site="tip" gear="1 0 0 0 0 0"/>',
    "glue": '<adhesion body="b" ctrlrange="0 9" gain="9"/>',
    "a crank": '<motor slidersite="rail" cranksite="tip" cranklength="1"/>',
}


@pytest.mark.parametrize("element", ELSEWHERE.values(), ids=ELSEWHERE)
def test_an_actuator_that_acts_at_no_joint_is_said_not_to_be_read(element: str, tmp_path: Path) -> None:
    text = body(TWO + SITES, actuator(element))
    says = "not read, though they act in MuJoCo: actuators at sites, bodies or cranks"
    assert says in arm_from(text, tmp_path).notes


def test_the_paths_of_meshes_are_those_that_mujoco_loads(tmp_path: Path) -> None:
    """Of an attached file the folder of meshes is its own; a mesh of vertices in the MJCF has no file to show."""
    for folder in ("parts", "tools"):
        (tmp_path / folder).mkdir()
        trimesh.creation.box((0.1, 0.1, 0.2)).export(tmp_path / folder / f"{folder}.stl")
    tool = body('<joint name="two"/><geom type="mesh" mesh="t"/>', '<asset><mesh name="t" file="tools.stl"/></asset>')
    (tmp_path / "tool.xml").write_text(tool.replace("<mujoco>", '<mujoco model="tool"><compiler meshdir="tools"/>'))
    assets = '<asset><mesh name="p" file="parts.stl"/><mesh name="v" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>'
    shapes = '<joint name="zero"/><geom type="mesh" mesh="v"/><geom type="mesh" mesh="p"/>'
    text = (
        f'<mujoco><compiler meshdir="parts"/>{assets}<model name="tool" file="tool.xml"/></asset><worldbody>'
        f'<body>{shapes}<frame><attach model="tool" body="a" prefix="x/"/></frame></body></worldbody></mujoco>'
    )
    (tmp_path / "lab.xml").write_text(text)
    urdf, _ = read_mjcf(tmp_path / "lab.xml", tmp_path)
    assert re.findall('filename="(.*?)"', urdf) == ["parts/parts.stl", "tools/tools.stl"]


def test_an_armature_beside_that_of_a_rotor_is_said_not_to_be_read(tmp_path: Path) -> None:
    notes = arm_from(driven(SPRING).replace('name="two"', 'name="two" armature="0.3"', 1), tmp_path).notes
    assert "not read, though they act in MuJoCo: armature of two beside that of its rotor" in notes


def body(inside: str, more: str = "") -> str:
    """Return an MJCF of two links; inside: of the second one."""
    first = '<joint name="one" axis="0 1 0"/><geom type="sphere" size="0.1" pos="0 0 0.2"/>'
    second = f'<body name="b" pos="0 0 0.4"><geom type="sphere" size="0.1" pos="0 0 0.2"/>{inside}</body>'
    return f'<mujoco><worldbody><body name="a">{first}{second}</body></worldbody>{more}</mujoco>'


TWO = '<joint name="two" axis="0 1 0"/>'
ENDS = '<joint joint="one" coef="1"/><joint joint="two" coef="-1"/>'
TENDON = f'<tendon><fixed name="belt" stiffness="3">{ENDS}</fixed></tendon>'
ROTOR = '<body><joint name="two_motor" axis="0 1 0" armature="1"/><geom size="0.01"/></body></worldbody>'
SPRING = (
    '<tendon><fixed name="two_spring" stiffness="300" springlength="0">'
    '<joint joint="two_motor" coef="1"/><joint joint="two" coef="-1"/></fixed></tendon>'
)


def driven(spring: str) -> str:
    """Return an MJCF whose second link is driven by a rotor through a spring."""
    return body(TWO, spring).replace("</worldbody>", ROTOR)


REFUSED = {
    "a spring with damping": (driven(SPRING.replace("<fixed", '<fixed damping="2"')), "'two_spring' is a tendon"),
    "a spring with a length": (driven(SPRING.replace('"0"', '"0.1"')), "'two_spring' is a tendon; expected joints"),
    "free joint": (
        '<mujoco><worldbody><body><freejoint name="float"/><geom size="1"/></body></worldbody></mujoco>',
        "body 'body1' has a free joint; expected hinges and slides only",
    ),
    "ball joint": (
        body('<joint name="two" type="ball"/>'),
        "body 'b' has a ball joint; expected hinges and slides only",
    ),
    "tendon": (body(TWO, TENDON), "'belt' is a tendon; expected joints without tendons, or the springs of our export"),
    "name of a spring, another length": (
        body(TWO, TENDON.replace("belt", "one_spring")),
        "'one_spring' is a tendon; expected joints without",
    ),
    "closed chain": (
        body(TWO, '<equality><weld name="loop" body1="b"/></equality>'),
        r"equality constraint 'loop' couples bodies or joints \(a closed chain\); expected an arm whose joints move by",
    ),
    "closed chain without a name": (
        body(TWO, '<equality><joint joint1="one" joint2="two"/></equality>'),
        "equality constraint 'equality0' couples bodies or joints",
    ),
    "wrong path of a mesh": (
        body(TWO, '<asset><mesh name="m" file="none.stl"/></asset>'),
        "MuJoCo says: .*none.stl.*; expected an MJCF that it loads",
    ),
    "unknown element": (body(TWO, "<legs/>"), "MuJoCo says: .*legs.*; expected an MJCF that it loads"),
    "massless link": (body(TWO).replace('<geom type="sphere" size="0.1" pos="0 0 0.2"/>', ""), "MuJoCo says: .*mass"),
    "no joint": (body("").replace('<joint name="one" axis="0 1 0"/>', ""), "the MJCF has no joint; expected an arm"),
    "a number that is none": (body(TWO).replace('size="0.1"', 'size="nan"'), "MuJoCo says: .*nan size"),
}


@pytest.mark.parametrize(("text", "says"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_serial_arm_is_refused_in_one_sentence(
    text: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RobotError, match=says) as refused:
        arm_from(text, tmp_path)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_a_spring_of_an_export_is_read(tmp_path: Path) -> None:
    arm = arm_from(driven(SPRING), tmp_path)
    assert np.diag(arm.robot.K)[1] == pytest.approx(300.0)
    assert np.diag(arm.robot.M_m)[1] == pytest.approx(1.0)


def test_a_tendon_without_force_and_a_constraint_that_is_off_do_not_matter(tmp_path: Path) -> None:
    idle = TENDON.replace('stiffness="3"', "") + '<equality><weld body1="b" active="false"/></equality>'
    assert arm_from(body(TWO, idle), tmp_path).joints == ("one", "two")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<mujoco", "does not parse as XML"),
        ("<sdf/>", "has the root element <sdf>; expected the <robot> of a URDF"),
        (REFUSED["free joint"][0], "lab.xml: body 'body1' has a free joint"),
    ],
)
def test_the_command_refuses_another_file_without_writing(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "lab.xml").write_text(text)
    assert says in fjr_here("new", str(tmp_path / "lab.xml"), "--output", str(tmp_path / "out"), code=2)
    assert not (tmp_path / "out").exists()


def test_without_mujoco_the_command_names_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("fjr_engines.mjcf")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    (tmp_path / "lab.xml").write_text(ARM)
    expected = f"mujoco is not installed; expected it from: {PIP} mujoco"
    assert expected in fjr_here("new", str(tmp_path / "lab.xml"), "--output", str(tmp_path), code=1)
    assert expected in fjr_here("export-mjcf", "arm7", str(tmp_path / "out.xml"), code=1)
