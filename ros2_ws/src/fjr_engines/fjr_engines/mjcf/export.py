# SPDX-License-Identifier: Apache-2.0
"""Export the robot of a scenario as an MJCF for MuJoCo alone: dynamics, limits, motors, sensors, start, looks.

A motor acts at the rotor `<joint>_motor` with the gear B_m. Sensors read both sides of each joint, and the torque of
its spring: the length K (q_m - q_l) of a tendon `<joint>_torque` that exerts no force. The keyframe `start` is the
initial state. The meshes of the URDF are written beside the file.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from fjr_core.config.robot import description, locked_positions
from fjr_core.config.scenario import Scenario, left_out
from fjr_core.errors import RobotError
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import MOTOR, Array, is_diagonal
from fjr_core.urdf.tree import UrdfTree, read_urdf
from fjr_monitor.scene import shapes
from fjr_plant.engine import chain

from .writing import LINK, pose_of, quaternion, refusals, specification

TORQUE = "_torque"
"""Ending of the name of the tendon and the sensor for the torque of a spring."""
LOOKS, GREY = 2, (0.8, 0.8, 0.8, 1.0)  # group of geoms that are seen only; colour of shapes without one
SENSORS, GEOMS = mujoco.mjtSensor, mujoco.mjtGeom
DIGITS, ALL_DIGITS = 6, 17


def mjcf(scenario: Scenario, name: str) -> tuple[dict[str, bytes], list[str]]:
    """Return the contents of the files by path, first the MJCF `name`, and a note for each thing that it leaves out.

    Raises RobotError for a robot that MuJoCo cannot express.
    """
    robot, joints = scenario.plant.robot, scenario.joints
    _refuse(scenario)
    spec = specification(robot, joints)
    spec.modelname, spec.meshdir, spec.compiler.degree = scenario.name, f"{Path(name).stem}_meshes", False
    spec.option.timestep = scenario.sample_period / scenario.inner_steps
    for k, joint in enumerate(joints):
        spec.body(joint + MOTOR).ipos = np.zeros(3)  # else the XML has no <inertial>
        _add_limits(spec, robot, k, joint)
        _add_sensors(spec, float(robot.K[k, k]), joint)
    values = scenario.plant_values
    unseen = add_looks(spec, robot, joints, description(values), locked_positions(values))
    _add_start(spec, scenario)
    return {name: _text(spec).encode(), **spec.assets}, [*_notes(scenario), *unseen]


def _refuse(scenario: Scenario) -> None:
    if scenario.plant.in_python:
        raise RobotError("the plant is a class of the user; expected plant.type: flexible_joint")
    for name in ("K", "B_m"):
        matrix = getattr(scenario.plant.robot, name)
        if not is_diagonal(matrix):
            raise RobotError(f"{name} is {matrix.tolist()}; expected a diagonal matrix: an MJCF couples no joints")


def _notes(scenario: Scenario) -> list[str]:
    """Return a sentence for each thing that the file leaves out."""
    robot = scenario.plant.robot
    notes = [f"robot.{robot.curve} is left out: springs have their stiffness at zero"] if robot.curve else []
    for name in ("D_l", "D_m"):
        matrix = getattr(robot, name)
        if not is_diagonal(matrix):
            notes.append(f"of {name} the diagonal only is in the file: dampers of MuJoCo couple no joints")
    for k, body in chain(robot):
        moments = np.linalg.eigvalsh(np.asarray(body.inertia))
        if moments[2] > (1 + 1e-9) * (moments[0] + moments[1]):
            notes.append(
                f"the inertia beyond joint '{scenario.joints[k]}' is none of a rigid body: the least moment is raised"
            )
    missing = [name for name in left_out(scenario) if name in scenario.plant_values]
    return notes + ([f"{', '.join(missing)} of the simulated robot are left out"] if missing else [])


def _add_limits(spec: mujoco.MjSpec, robot: Robot, k: int, joint: str) -> None:
    """Add the motor of a joint, and the limits of position and effort that the robot has."""
    motor = spec.add_actuator(name=joint + MOTOR, target=joint + MOTOR, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.set_to_motor()
    motor.gear = [robot.B_m[k, k], 0.0, 0.0, 0.0, 0.0, 0.0]
    if robot.limits is None:
        return
    lower, upper, effort = (each[k] for each in (robot.limits.lower, robot.limits.upper, robot.limits.effort))
    if np.isfinite([lower, upper]).all():
        spec.joint(joint).range = [lower, upper]
    if np.isfinite(effort):
        motor.ctrlrange = [-effort, effort]


def _add_sensors(spec: mujoco.MjSpec, stiffness: float, joint: str) -> None:
    for name in (joint, joint + MOTOR):
        for what, kind in (("position", SENSORS.mjSENS_JOINTPOS), ("velocity", SENSORS.mjSENS_JOINTVEL)):
            spec.add_sensor(name=f"{name}_{what}", type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name)
    gauge = spec.add_tendon(name=joint + TORQUE)
    gauge.wrap_joint(joint + MOTOR, stiffness)
    gauge.wrap_joint(joint, -stiffness)
    kind, tendon = SENSORS.mjSENS_TENDONPOS, mujoco.mjtObj.mjOBJ_TENDON
    spec.add_sensor(name=joint + TORQUE, type=kind, objtype=tendon, objname=joint + TORQUE)


def _add_start(spec: mujoco.MjSpec, scenario: Scenario) -> None:
    """Add the initial state as keyframe `start`; MuJoCo counts links from base to tip, then rotors."""
    robot = scenario.plant.robot
    order = [*(k for k, _ in chain(robot)), *range(robot.n, 2 * robot.n)]
    velocity = np.hstack(robot.velocities(scenario.x0))
    spec.add_key(name="start", qpos=scenario.x0[: 2 * robot.n][order], qvel=velocity[order])


def add_looks(
    spec: mujoco.MjSpec, robot: Robot, joints: Sequence[str], urdf: str, locked: Mapping[str, float]
) -> list[str]:
    """Add the shapes of the URDF text of a robot of the named joints; return a sentence for each that cannot be read.

    locked: positions [rad, m] of joints that do not move.
    """
    seen, tree = shapes(urdf, locked), read_urdf(urdf)
    for i, each in enumerate(seen["meshes"], 1):
        mesh = spec.add_mesh(name=f"mesh{i}", file=f"mesh{i}.stl", inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        stl = trimesh.Trimesh(each.vertices, each.triangles, process=False).export(file_type="stl")
        spec.assets |= {str(Path(spec.meshdir, mesh.file)): stl}
    bodies, pose = {"": (spec.worldbody, np.eye(4))}, np.eye(4)
    for k, body in chain(robot):
        pose = pose @ pose_of(body.translation, body.rotation)
        bodies[joints[k]] = spec.body(joints[k] + LINK), pose
    for link, found in seen["links"].items():
        joint, place = _placed(tree, link, joints, locked)
        owner, frame = bodies[joint]
        for shape in found:
            _add_geom(owner, shape, np.linalg.inv(frame) @ place)
    return list(seen["notes"])


def _placed(tree: UrdfTree, link: str, joints: Sequence[str], locked: Mapping[str, float]) -> tuple[str, Array]:
    """Return the joint that carries a link, "" for none, and the pose (4, 4) of the link in the base at q_l = 0."""
    owner, pose = "", np.eye(4)
    for joint in tree.above(link):
        owner = owner or (joint.name if joint.name in joints else "")
        pose = joint.pose(tree.position(joint, locked)) @ pose
    return owner, pose


def _add_geom(body: mujoco.MjsBody, shape: Mapping[str, Any], place: Array) -> None:
    """Add a shape of fjr_monitor.scene, whose link has this place (4, 4) in the body, as a geom that is only seen."""
    kind, size, colour = shape["kind"], shape.get("size", ()), shape["colour"]
    rgba = GREY if colour is None else (*(byte / 255 for byte in bytes.fromhex(colour[1:])), 1.0)  # of #rrggbb
    geom = body.add_geom(contype=0, conaffinity=0, group=LOOKS, rgba=rgba)
    if kind in ("capsule", "hub"):  # from the origin of the link; across it
        geom.type, start = (GEOMS.mjGEOM_CAPSULE, 0.0) if kind == "capsule" else (GEOMS.mjGEOM_CYLINDER, -0.5)
        ends = np.outer([start, start + 1.0], shape["to"]) @ place[:3, :3].T + place[:3, 3]
        geom.size, geom.fromto = [size[0], 0.0, 0.0], ends.ravel()
        return
    pose = place @ pose_of(shape["xyz"], Rotation.from_euler("xyz", shape["rpy"]).as_matrix())
    geom.pos, geom.quat = pose[:3, 3], quaternion(pose[:3, :3])
    if kind == "mesh":
        geom.type, geom.meshname = GEOMS.mjGEOM_MESH, f"mesh{shape['mesh'] + 1}"
    elif kind == "box":
        geom.type, geom.size = GEOMS.mjGEOM_BOX, np.asarray(size) / 2
    elif kind == "sphere":
        geom.type, geom.size = GEOMS.mjGEOM_SPHERE, [size[0], 0.0, 0.0]
    else:
        geom.type, geom.size = GEOMS.mjGEOM_CYLINDER, [size[0], size[1] / 2, 0.0]


def _text(spec: mujoco.MjSpec) -> str:
    """Return the XML with numbers that read back exactly; MuJoCo writes six digits unless its library is told."""
    library = ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("libmujoco*"))))
    library._mjPRIVATE__set_xml_precision(ALL_DIGITS)
    try:
        with refusals("a robot that it compiles"):
            return str(spec.to_xml())
    finally:
        library._mjPRIVATE__set_xml_precision(DIGITS)
