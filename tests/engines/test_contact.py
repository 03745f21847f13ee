# SPDX-License-Identifier: Apache-2.0
"""Contact in MuJoCo: the arm feels J'f, it touches where its shapes are, and where nothing touches nothing changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import fjr_core as fjr
from diagnosis_benchmark.lock_step import LockStepLoop, write_bag
from engines.walls import Array, loaded, met, random_walls, unchanged
from fjr_core.config.plant import Obstacle
from fjr_core.config.robot import description
from fjr_core.errors import FjrError
from fjr_core.urdf.tree import read_urdf
from fjr_engines.mujoco import MujocoEngine
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.report.write import report_bag
from fjr_msgs_py.scenarios import library
from fjr_plant.simulated_robot import SimulatedRobot, simulated

FAR = {"obstacle.position": [5.0, 0.0, 0.5]}
FRONT = {"obstacle.position": [0.76, 0.0, 0.5], "obstacle.normal": [-1.0, 0.0, 0.0], "obstacle.size": [1.0, 1.0, 0.1]}
"""A wall that the tool meets before 1 s."""
BOX = {"obstacle.type": "box", "obstacle.position": [0.25, -0.218, 0.6], "obstacle.size": [0.12, 0.2, 0.3]}
"""A box in the place of the wall of the scenario."""
SNIPPET = """<mujoco><worldbody><body pos="0.25 -0.2 0.6"><geom type="box" pos="0 -0.018 0" size="0.06 0.1 0.15"/>
</body></worldbody></mujoco>"""
DOOR = '<mujoco><worldbody><body><joint name="door"/><geom size="1"/></body></worldbody></mujoco>'


def motion(changes: dict[str, Any], duration: float = 1.0) -> tuple[Array, Array]:
    """Return measured positions (k, 2n), and contacts (k, n + 6) with their stamps [ns] in front."""
    loop = LockStepLoop(loaded(changes)).run(duration)
    contacts = [np.append(stamp, values) for stamp, values in loop.contacts]
    return loop.record().position, np.array(contacts).reshape(-1, 14)


def test_free_motion_beside_an_obstacle_is_bit_equal_to_that_without() -> None:
    free = motion({"obstacle.type": "none"}, 0.3)[0]
    for changes in (FAR, {"obstacle.present": False, **FRONT}):
        assert np.array_equal(motion(changes, 0.3)[0], free)


def test_torques_on_the_joints_are_those_of_the_wrench() -> None:
    """The torque of a force on the last link at joint j is its moment about the axis of j; by an independent chain."""
    position, contacts = motion(FRONT, 1.0)
    assert len(contacts) > 20
    for row in contacts[::10]:
        q = position[int(row[0] // 1_000_000) - 1000, :7]
        force, moment = row[8:11], row[11:14]
        expected = [axis @ (moment - np.cross(origin, force)) for origin, axis in axes(q)]
        np.testing.assert_allclose(row[1:8], expected, rtol=0, atol=0.02 * np.abs(row[1:8]).max())


def axes(q: Array) -> list[tuple[Array, Array]]:
    """Return origin and axis (3,) of each joint of arm7 in the base frame, from the poses in the URDF."""
    tree, T, found = read_urdf(description(unchanged().plant_values)), np.eye(4), []
    for name, angle in zip(unchanged().joints, q, strict=True):
        joint = tree.joints[name]
        T = T @ joint.pose(float(angle))
        found.append((T[:3, 3], T[:3, :3] @ joint.axis))
    return found


def test_a_table_carries_an_arm_without_effort() -> None:
    """At rest the table gives the weight torque, less that of the spring; the link creeps against its damping."""
    table = {"obstacle.type": "table", "obstacle.position": [0.0, 0.0, -0.1], "obstacle.size": [1.0, 1.0, 0.05]}
    start = {"initial_link_position": [1.5], "initial_motor_position": [1.5], "engine": "mujoco"}
    scenario = library.as_run(library.find("paper_k31"), {**start, **table})[1]
    robot, _ = simulated(scenario.plant_values, scenario.plant, scenario.x0)
    for time in (10.0, 10.001):  # the contact is a mean over the last advance
        robot.advance_to(round(time * 1e9))
    (q_l, _), (dq_l, _), (spring, _) = robot.measure()
    assert abs(dq_l) < 0.02
    weight = float(scenario.robot.grad_P_l(np.array([q_l]))[0])
    assert weight > 0.5
    np.testing.assert_allclose(robot.contact[0], weight + scenario.robot.D_l[0, 0] * dq_l - spring, rtol=5e-3)


def test_an_mjcf_is_the_obstacle_that_it_describes(tmp_path: Path) -> None:
    (tmp_path / "box.xml").write_text(SNIPPET)
    seen = motion(BOX)[1]
    assert len(seen) > 20
    for given in (SNIPPET, str(tmp_path / "box.xml")):
        other = motion({"obstacle.type": "mjcf", "obstacle.mjcf": given})[1]
        np.testing.assert_allclose(other, seen, rtol=1e-6, atol=1e-6)


SHAPES = {
    "box": ('<box size="0.1 0.08 0.3"/>', 0.04),
    "cylinder": ('<cylinder radius="0.05" length="0.3"/>', 0.05),
    "sphere": ('<sphere radius="0.06"/>', 0.06),
    "mesh": ('<mesh filename="file://{mesh}" scale="0.5 1 1"/>', 0.07),
    "none": ("", 0.03 * 0.4),  # a capsule of 3 % of the reach
}
URDF = """<robot name="rod"><link name="base"/><joint name="joint1" type="continuous"><parent link="base"/>
<child link="rod"/><axis xyz="0 1 0"/></joint><link name="rod"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>{visual}</link></robot>"""


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_links_have_the_shapes_of_their_visuals(shape: str, side: float, tmp_path: Path) -> None:
    """A hanging rod is outside a wall 1 mm beside its shape, and inside one that is 1 mm too near."""
    trimesh.creation.box((0.2, 0.14, 0.3)).export(tmp_path / "box.stl")
    geometry, half = SHAPES[shape]
    visual = f'<visual><origin xyz="0 0.01 -0.2"/><geometry>{geometry}</geometry></visual>' if geometry else ""
    urdf = URDF.format(visual=visual.format(mesh=tmp_path / "box.stl"))
    robot, middle = fjr.robot_from_urdf(urdf, ["joint1"], 31.0, 0.004), 0.01 if geometry else 0.0

    def start(gap: float) -> None:
        position, normal = (0.0, middle + side * (half + gap), -0.2), (0.0, -side, 0.0)
        wall = Obstacle("wall", np.array(position), np.array([0.1, 0.1, 0.1]), np.array(normal), urdf=urdf)
        SimulatedRobot(fjr.Plant(robot), np.zeros(4), 250_000, engine=MujocoEngine, joints=["joint1"], obstacle=wall)

    start(1e-3)
    with pytest.raises(FjrError, match="1 mm inside the link of joint1; expected it outside the arm"):
        start(-1e-3)


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "own engine": ({"engine": "own"}, "'wall' with engine 'own'; expected engine: mujoco"),
    "inside the arm": ({"obstacle.position": [0.25, 0.0, 0.6]}, "inside the link of joint5; expected it outside"),
    "negative size": ({"obstacle.size": [0.3, -0.1, 0.1]}, "'obstacle.size' holds -0.1 m; expected at least 0.001 m"),
    "no direction": ({"obstacle.normal": [0.0, 0.0, 0.0]}, "'obstacle.normal' is .*; expected a direction"),
    "missing file": ({"obstacle.type": "mjcf", "obstacle.mjcf": "no.xml"}, "no.xml'; expected a file, or XML text"),
    "invalid MJCF": ({"obstacle.type": "mjcf", "obstacle.mjcf": "<mujoco><wall/></mujoco>"}, "expected a valid MJCF"),
    "no geom": ({"obstacle.type": "mjcf", "obstacle.mjcf": "<mujoco/>"}, "has no geom; expected at least one"),
    "moving MJCF": (
        {"obstacle.type": "mjcf", "obstacle.mjcf": DOOR},
        "has the joint 'door'; expected bodies that do not move",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_impossible_obstacle_is_refused_in_one_sentence(case: str) -> None:
    changes, sentence = REFUSED[case]
    with pytest.raises(FjrError, match=sentence) as refused:
        LockStepLoop(loaded(changes))
    assert "\n" not in str(refused.value)


def test_an_obstacle_comes_back_only_where_the_arm_is_not() -> None:
    loop = LockStepLoop(loaded({"obstacle.present": False, **FRONT})).run(1.0)
    with pytest.raises(FjrError, match="expected it outside the arm"):
        loop._robot.obstruct(True)
    loop.run(1.5)
    assert not loop.contacts
    loop._robot.obstruct(True)
    loop.run(2.9)
    assert loop.contacts


@pytest.mark.full  # at one wall: test_contact_nodes.py
def test_report_at_random_walls_names_the_joints_and_the_force(tmp_path: Path) -> None:
    for k, wall in enumerate(random_walls(3, seed=102)):
        seen = met(wall, tmp_path / str(k))
        assert seen.external
        assert seen.right
        assert seen.finite
        assert not seen.beyond
        assert seen.force == pytest.approx(seen.own_force, rel=0.1)


def test_force_at_the_tip_of_a_robot_without_simulator_is_that_of_its_joint_torques(tmp_path: Path) -> None:
    """A push of J'f for 0.1 s in the plant's own integrator, whose bag has no contact."""
    loop = LockStepLoop(loaded({"engine": "own", "obstacle.type": "none"})).run(0.9)
    force = np.array([20.0, 30.0, -10.0])
    q, end, step = loop._robot.x[:7], loop.scenario.robot.links.end_effector.position, 1e-6
    moved = [end(q + s * step * e, np.zeros(3)).full().ravel() for s in (1, -1) for e in np.eye(7)]
    J = (np.array(moved[:7]) - np.array(moved[7:])).T / (2 * step)
    loop._robot.external = J.T @ force
    loop.run(1.0)
    loop._robot.external = np.zeros(7)
    loop.run(1.4)
    write_bag(loop, tmp_path / "bag")
    report = report_bag("tip", read_bag(tmp_path / "bag"), loop.scenario, tmp_path, pages=False).report
    assert report.contact is not None
    assert report.contact.force_at == "at the tip"
    assert report.contact.simulated_force_n is None
    assert (report.contact.begins_s, report.contact.ends_s) == pytest.approx((0.9, 1.0), abs=0.006)
    assert report.contact.force_n == pytest.approx(float(np.linalg.norm(force)), rel=0.05)
