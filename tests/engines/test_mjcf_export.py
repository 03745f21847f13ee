# SPDX-License-Identifier: Apache-2.0
"""An exported MJCF is the robot: MuJoCo alone repeats a recorded motion, and the file gives the robot back."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from tools.robot_survey import ROBOTS

from core.oracles.chains import random_urdf
from docs.pages import ROOT
from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_core.errors import RobotError
from fjr_design.scaffold.arm import arm_of
from fjr_engines.mjcf.export import mjcf
from fjr_engines.mjcf.reading import read_mjcf
from fjr_msgs_py.scenarios import library
from system.executables import fjr_here, python_here
from system.shared_runs import shared_run
from two_link_urdf import two_link_urdf

UR5E = next(robot.urdf for robot in ROBOTS if robot.name == "Universal Robots UR5e")
UR5E_JOINTS = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint"]


def scenario(urdf: str, joints: list[str], **robot: object) -> Scenario:
    """Return a scenario of a URDF, a path or its text, with stiffness and motor inertia that no one guesses."""
    n = len(joints)
    known = {
        "joint_stiffness": [1000.0 / 3.0 + k for k in range(n)],
        "motor_inertia": [0.1 + k / 7.0 for k in range(n)],
    }
    given = {"joints": joints, "robot": {"model": "urdf", "urdf": urdf, **known, **robot}}
    given |= {name: [0.1 * k for k in range(n)] for name in ("initial_link_position", "initial_motor_velocity")}
    return parse_scenario("arm", json.dumps({"/**": {"ros__parameters": given}}))


def random_chain() -> Scenario:
    """Return three joints of a random URDF in another order than along the chain; one slides, gravity is oblique."""
    case = random_urdf(3, seed=4)
    locked = {"locked_joints": list(case.locked), "locked_positions": list(case.locked.values())}
    found = scenario(case.xml, case.joints, gravity=list(case.gravity), **locked)
    assert any(found.robot.prismatic)
    assert found.robot.links.order != (0, 1, 2)
    return found


CASES = {name: lambda name=name: library.load(name) for name in ("paper_k31", "two_link", "arm7")}
CASES |= {"UR5e": lambda: scenario(str(UR5E), UR5E_JOINTS), "random chain": random_chain}


def written(case: Scenario, folder: Path) -> Path:
    """Write the files of an export; return the MJCF."""
    files, _ = mjcf(case, "arm.xml")
    for path, content in files.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(content)
    return folder / "arm.xml"


def poses(n: int) -> np.ndarray:
    return np.random.default_rng(7).uniform(-1.5, 1.5, (20, n))


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_file_gives_the_robot_back(case, tmp_path: Path) -> None:
    found = case()
    text, known = read_mjcf(written(found, tmp_path), tmp_path)
    own, arm = found.robot, arm_of(tmp_path / "arm.urdf", found.joints, text=text, known=known)
    assert arm.joints == found.joints
    for q_l in poses(own.n):
        assert arm.robot.M_l(q_l) == pytest.approx(own.M_l(q_l), rel=1e-9, abs=1e-11)
        assert arm.robot.grad_P_l(q_l) == pytest.approx(own.grad_P_l(q_l), rel=1e-9, abs=1e-9)
    assert np.array_equal(arm.robot.K, own.K)
    assert np.array_equal(arm.robot.M_m, own.M_m)
    if own.limits is not None:
        for name in ("lower", "upper", "effort"):
            assert getattr(arm.robot.limits, name) == pytest.approx(getattr(own.limits, name), rel=1e-15)


@pytest.mark.parametrize("name", ["paper_k31", "arm7", "random chain"])
def test_mujoco_has_both_sides_of_each_joint(name: str, tmp_path: Path) -> None:
    """Inertia, start, sensors and motors, as MuJoCo computes them."""
    found = CASES[name]()
    robot, joints, n = found.robot, found.joints, found.robot.n
    model = mujoco.MjModel.from_xml_path(str(written(found, tmp_path)))
    data, rng = mujoco.MjData(model), np.random.default_rng(3)
    link, motor = ([model.joint(each + end).qposadr[0] for each in joints] for end in ("", "_motor"))
    mujoco.mj_resetDataKeyframe(model, data, 0)
    velocities = np.hstack(robot.velocities(found.x0))
    assert np.allclose(np.hstack([data.qpos[link], data.qpos[motor]]), found.x0[: 2 * n], rtol=1e-15, atol=0)
    assert np.allclose(np.hstack([data.qvel[link], data.qvel[motor]]), velocities, rtol=1e-12, atol=1e-15)
    data.qpos, data.qvel, data.ctrl = rng.normal(size=2 * n), rng.normal(size=2 * n), rng.normal(size=n)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((2 * n, 2 * n))
    mujoco.mj_fullM(model, data, inertia)
    assert inertia[np.ix_(link, link)] == pytest.approx(robot.M_l(data.qpos[link]), rel=1e-9, abs=1e-10)
    assert inertia[np.ix_(motor, motor)] == pytest.approx(robot.M_m, abs=1e-11)
    assert data.qfrc_actuator[motor] == pytest.approx(robot.B_m @ data.ctrl)
    for k, joint in enumerate(joints):
        seen = {name: data.sensor(joint + name).data[0] for name in ("_position", "_motor_velocity", "_torque")}
        assert seen["_position"] == data.qpos[link[k]]
        assert seen["_motor_velocity"] == data.qvel[motor[k]]
        assert seen["_torque"] == pytest.approx(robot.K[k, k] * (data.qpos[motor[k]] - data.qpos[link[k]]))


def test_mujoco_alone_repeats_the_recorded_motion(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The example of 20 lines, on two seconds of arm7."""
    (bag,) = (shared_run(tmp_path_factory, "arm7") / "bag").glob("*.mcap")
    fjr_here("export-mjcf", "arm7", str(tmp_path / "arm.xml"))
    example = ROOT / "examples" / "recorded_motion_in_mujoco.py"
    monkeypatch.setattr("sys.argv", [str(example), str(tmp_path / "arm.xml"), str(bag)])
    said = python_here(example.read_text(encoding="utf-8"), example).split()
    assert said[:5] == ["2000", "states", "of", "14", "coordinates,"]
    assert float(said[7]) < 1e-6


def test_the_command_writes_a_file_that_new_reads(tmp_path: Path) -> None:
    file = tmp_path / "arm7.xml"
    said = fjr_here("export-mjcf", "arm7", str(file), "--set", "imperfections.payload_mass:=0.5", "--json")
    output, _ = json.JSONDecoder().raw_decode(said)
    assert output["files"] == [str(file)]
    assert output["notes"] == ["imperfections.payload_mass of the simulated robot are left out"]
    assert "exists; expected a new file" in fjr_here("export-mjcf", "arm7", str(file), code=1)
    said = fjr_here("new", str(file), "--output", str(tmp_path))
    assert f"written    {tmp_path / 'arm7.urdf'}, {tmp_path / 'arm7_robot.yaml'}" in said
    assert "GUESS" not in said
    again, own = library.load(str(tmp_path / "arm7.yaml")).robot, library.load("arm7").robot
    assert np.array_equal(again.K, own.K)
    assert np.array_equal(again.M_m, own.M_m)
    assert again.limits.effort == pytest.approx(own.limits.effort)


MESH = """<visual><origin xyz="0.1 0.2 0.3" rpy="0.3 -0.5 0.7"/><geometry><mesh filename="part.stl" scale="2 2 2"/>
</geometry><material name="red"><color rgba="1 0 0 1"/></material></visual>"""


def test_a_mesh_stands_where_the_urdf_has_it_there_and_back(tmp_path: Path) -> None:
    part = trimesh.creation.box((0.1, 0.2, 0.3)).apply_translation((0.2, 0.0, 0.1))
    part.export(tmp_path / "part.stl")
    (tmp_path / "own.urdf").write_text(two_link_urdf().replace('<link name="lower">', f'<link name="lower">{MESH}'))
    origin = trimesh.transformations.euler_matrix(0.3, -0.5, 0.7)
    origin[:3, 3] = 0.1, 0.2, 0.3 - 0.3  # the elbow is 0.3 m below the base
    expected = trimesh.transform_points(2 * part.bounds, origin)
    for urdf in ("own.urdf", "arm.urdf"):
        file = written(scenario(str(tmp_path / urdf), ["shoulder", "elbow"]), tmp_path)
        model = mujoco.MjModel.from_xml_path(str(file))
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        (geom,) = np.flatnonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH))
        corners = data.geom_xpos[geom] + model.mesh_vert @ data.geom_xmat[geom].reshape(3, 3).T
        assert all(np.abs(corners - point).max(axis=1).min() < 1e-6 for point in expected)
        assert model.geom_rgba[geom] == pytest.approx([1.0, 0.0, 0.0, 1.0])
        (tmp_path / "arm.urdf").write_text(read_mjcf(file, tmp_path)[0])


COUPLED = [40.0, 5.0, 5.0, 25.0]


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("robot.joint_stiffness", COUPLED, "K is .*; expected a diagonal matrix: an MJCF couples no joints"),
        ("robot.input_gain", [1.0, 0.1, 0.0, 1.0], "B_m is .*; expected a diagonal matrix"),
    ],
)
def test_a_robot_that_mujoco_cannot_express_is_refused(name: str, value: list[float], says: str) -> None:
    with pytest.raises(RobotError, match=says):
        mjcf(library.load("two_link", [f"{name}:={value}"]), "arm.xml")


def test_what_the_file_leaves_out_is_said() -> None:
    damping, cubic = "robot.link_damping:=[0.2, 0.01, 0.01, 0.1]", "robot.cubic_stiffness:=[100.0, 0.0]"
    assert mjcf(library.load("two_link", [damping, cubic]), "arm.xml")[1] == [
        "robot.cubic_stiffness is left out: springs have their stiffness at zero",
        "of D_l the diagonal only is in the file: dampers of MuJoCo couple no joints",
    ]
    thin = two_link_urdf().replace('izz="0.005"', 'izz="0.02"')
    assert mjcf(scenario(thin, ["shoulder", "elbow"]), "arm.xml")[1] == [
        "the inertia beyond joint 'elbow' is none of a rigid body: the least moment is raised"
    ]
