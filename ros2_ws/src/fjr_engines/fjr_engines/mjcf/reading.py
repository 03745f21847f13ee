# SPDX-License-Identifier: Apache-2.0
"""Read an MJCF arm through MuJoCo: its bodies as a URDF, and what a URDF lacks, motor inertia and stiffness.

MuJoCo's compiler resolves defaults, included files, orientations and inertia from shapes. A joint turns the body about
an anchor, which becomes the origin of the link. In a file of `fjr export-mjcf` rotors and springs are recognised.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import RobotError
from fjr_core.numerics.checks import MOTOR, Array
from fjr_design.scaffold.files import path_from

from .writing import SPRING, refusals

AT_JOINTS = int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)
AT_TENDONS = int(mujoco.mjtTrn.mjTRN_TENDON)
JOINTS = {int(mujoco.mjtJoint.mjJNT_HINGE): "revolute", int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic"}
Element = ElementTree.Element


def read_mjcf(file: Path, folder: Path) -> tuple[str, dict[str, Any]]:
    """Return an arm as the text of a URDF for this folder, with its `gravity` and what is known of its joints.

    The latter has the form of an entry of joint_data.yaml, with 0 for what is not known. Raises RobotError for a file
    that MuJoCo refuses, and for free and ball joints, tendons other than our springs, and equality constraints.
    """
    with refusals("an MJCF that it loads"):
        spec = mujoco.MjSpec.from_file(str(file))
        model = spec.compile()
    if not model.njnt:
        raise RobotError("the MJCF has no joint; expected an arm of hinges and slides")
    arm = _Arm(model, springs_of(model))
    weightless = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    known = {
        "joints": [arm.joint(joint) for joint in arm.joints],
        "source": file.name,
        "motor_inertia": [_motor_inertia(model, arm.drive(joint)) for joint in arm.joints],
        "joint_stiffness": [arm.springs[joint][1] if joint in arm.springs else 0.0 for joint in arm.joints],
        "gravity": [0.0] * 3 if weightless else model.opt.gravity.tolist(),
    }
    meshes = [path_from(folder, Path(spec.modelfiledir, spec.meshdir, each.file)) for each in spec.meshes]
    return arm.urdf(spec.modelname or file.stem, meshes), known


def springs_of(model: mujoco.MjModel) -> dict[int, tuple[int, float]]:
    """Return rotor and stiffness [N m/rad] behind each joint that has a spring; raise RobotError for other couplings.

    A spring is a fixed tendon `<joint>_spring` of the length q_m - q_l. A tendon that exerts no force may stay.
    """
    for joint in map(model.joint, np.flatnonzero(~np.isin(model.jnt_type, list(JOINTS)))):
        what = "ball" if joint.type[0] == int(mujoco.mjtJoint.mjJNT_BALL) else "free"
        raise RobotError(f"joint '{joint.name}' is {what}; expected hinges and slides on a fixed base")
    for constraint in map(model.eq, np.flatnonzero(model.eq_active0)):
        raise RobotError(
            f"equality constraint '{constraint.name}' couples bodies or joints (a closed chain); expected an arm whose "
            "joints move by themselves"
        )
    found = {}
    for tendon in filter(lambda tendon: _pulls(model, tendon), range(model.ntendon)):
        name, parts = model.tendon(tendon).name, model.tendon_adr[tendon] + np.arange(model.tendon_num[tendon])
        ends = dict(zip(model.wrap_prm[parts], model.wrap_objid[parts], strict=True))
        joint = name.removesuffix(SPRING)
        sides = [model.joint(end).name for _, end in sorted(ends.items())]
        if sides != [joint, joint + MOTOR] or set(ends) != {-1.0, 1.0}:
            raise RobotError(f"'{name}' is a tendon; expected joints without tendons, or the springs of our export")
        found[int(ends[-1.0])] = int(ends[1.0]), float(model.tendon_stiffness[tendon])
    return found


def _pulls(model: mujoco.MjModel, tendon: int) -> bool:
    """Return whether a tendon exerts a force, by itself or by an actuator."""
    moves = model.actuator_trnid[model.actuator_trntype == AT_TENDONS, 0]
    forces = ("stiffness", "damping", "frictionloss", "armature", "limited")
    return tendon in moves or any(getattr(model, f"tendon_{force}")[tendon] for force in forces)


@dataclass(frozen=True)
class _Arm:
    """A compiled model as links and joints of a URDF; springs: those of springs_of."""

    model: mujoco.MjModel
    springs: Mapping[int, tuple[int, float]]

    @property
    def joints(self) -> list[int]:
        """The joints but those of rotors."""
        rotors = {rotor for rotor, _ in self.springs.values()}
        return [joint for joint in range(self.model.njnt) if joint not in rotors]

    def drive(self, joint: int) -> int:
        """Return the joint at which the motor acts: that of the rotor, if there is one."""
        return self.springs[joint][0] if joint in self.springs else joint

    def joint(self, number: int) -> str:
        """Return the name of a joint; MJCF does not ask for one."""
        return self.model.joint(number).name or f"joint{number}"

    def link(self, number: int) -> str:
        """Return the name of a body."""
        return self.model.body(number).name or f"body{number}"

    def urdf(self, name: str, meshes: Sequence[str]) -> str:
        """Return the text; meshes: the path of each mesh."""
        model, robot = self.model, ElementTree.Element("robot", name=name)
        rotors = {model.jnt_bodyid[rotor] for rotor, _ in self.springs.values()}
        places: dict[int, Array] = {}  # of each body in the frame of its link
        for body in range(model.nbody):
            if body in rotors:
                continue
            before = places.get(model.body_parentid[body], np.eye(4))
            pose = before @ _pose(model.body_pos[body], model.body_quat[body])
            places[body] = self._add_joints(robot, body, pose) if body else pose
            link = ElementTree.SubElement(robot, "link", name=self.link(body))
            self._add_inertia(link, body, places[body])
            for geom in self._visible(body):
                _add_visual(link, model, geom, places[body], meshes)
        ElementTree.indent(robot)
        return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"

    def _add_joints(self, robot: Element, body: int, place: Array) -> Array:
        """Add the joints of a body at its place (4, 4) in the link before; return its place in its own link."""
        model, first = self.model, self.model.body_jntadr[body]
        joints = range(first, first + model.body_jntnum[body])
        parent, link = self.link(model.body_parentid[body]), self.link(body)
        if not joints:
            _add_joint(robot, f"{link}_fixed", "fixed", parent, link, place)
            return np.eye(4)
        for joint in joints:
            child = link if joint == joints[-1] else f"{link}_{self.joint(joint)}"
            if child != link:
                ElementTree.SubElement(robot, "link", name=child)
            axis, slides = model.jnt_axis[joint], JOINTS[model.jnt_type[joint]] == "prismatic"
            zero, limited = -model.qpos0[model.jnt_qposadr[joint]], model.jnt_limited[joint]
            turn = (1.0, 0.0, 0.0, 0.0) if slides else [np.cos(zero / 2), *(np.sin(zero / 2) * axis)]
            origin = place @ _pose(model.jnt_pos[joint] + slides * zero * axis, turn)
            kind = "prismatic" if slides else "revolute" if limited else "continuous"
            element = _add_joint(robot, self.joint(joint), kind, parent, child, origin)
            ElementTree.SubElement(element, "axis", xyz=_text(axis))
            lower, upper = model.jnt_range[joint] if limited else (0.0, 0.0)
            effort = effort_limit(model, self.drive(joint))
            limits = {"lower": lower, "upper": upper, "velocity": 0.0, "effort": effort}
            ElementTree.SubElement(element, "limit", {key: _text(value) for key, value in limits.items()})
            parent, place = child, _pose(-model.jnt_pos[joint])
        return place

    def _add_inertia(self, link: Element, body: int, place: Array) -> None:
        model = self.model
        if not model.body_mass[body]:
            return
        pose = place @ _pose(model.body_ipos[body], model.body_iquat[body])
        J = pose[:3, :3] @ np.diag(model.body_inertia[body]) @ pose[:3, :3].T
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "origin", xyz=_text(pose[:3, 3]))
        ElementTree.SubElement(inertial, "mass", value=_text(model.body_mass[body]))
        entries = {"ixx": J[0, 0], "ixy": J[0, 1], "ixz": J[0, 2], "iyy": J[1, 1], "iyz": J[1, 2], "izz": J[2, 2]}
        ElementTree.SubElement(inertial, "inertia", {name: _text(value) for name, value in entries.items()})

    def _visible(self, body: int) -> Iterator[int]:
        """Yield the geoms that show a body: those that never touch anything, else all."""
        model, first = self.model, self.model.body_geomadr[body]
        geoms = np.arange(first, first + model.body_geomnum[body])
        shown = geoms[(model.geom_contype[geoms] == 0) & (model.geom_conaffinity[geoms] == 0)]
        yield from shown if len(shown) else geoms


def effort_limit(model: mujoco.MjModel, joint: int) -> float:
    """Return the largest effort [N m] of the actuators of a joint in both directions; 0: no limit."""
    found = [-1.0, 1.0] * model.jnt_actfrcrange[joint] if model.jnt_actfrclimited[joint] else []
    for actuator in _actuators(model, joint):
        if actuator.forcelimited[0]:
            found = [*found, *np.abs(actuator.gear[0] * actuator.forcerange)]
        elif actuator.ctrllimited[0] and actuator.biastype[0] == int(mujoco.mjtBias.mjBIAS_NONE):
            found = [*found, *np.abs(actuator.gear[0] * actuator.gainprm[0] * actuator.ctrlrange)]
    return float(min(found, default=0.0))


def _motor_inertia(model: mujoco.MjModel, joint: int) -> float:
    """Return the armature at a joint [kg m^2] and that of its actuators, reflected by the gear."""
    motors = [actuator.id for actuator in _actuators(model, joint)]
    reflected = model.actuator_gear[motors, 0] ** 2 * model.actuator_armature[motors]
    return float(model.dof_armature[model.jnt_dofadr[joint]] + reflected.sum())


def _actuators(model: mujoco.MjModel, joint: int) -> list[Any]:
    here = np.isin(model.actuator_trntype, AT_JOINTS) & (model.actuator_trnid[:, 0] == joint)
    return [model.actuator(actuator) for actuator in np.flatnonzero(here)]


def _add_joint(robot: Element, name: str, kind: str, parent: str, child: str, origin: Array) -> Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=_text(origin[:3, 3]), rpy=_text(rpy_of(origin[:3, :3])))
    return joint


def _add_visual(link: Element, model: mujoco.MjModel, geom: int, place: Array, meshes: Sequence[str]) -> None:
    """Add the shape of a geom, if a URDF has it; a capsule is a cylinder."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_")
    size, mesh = model.geom_size[geom], model.geom_dataid[geom]
    pose = place @ _pose(model.geom_pos[geom], model.geom_quat[geom])
    if kind == "BOX":
        tag, attributes = "box", {"size": _text(2 * size)}
    elif kind == "SPHERE":
        tag, attributes = "sphere", {"radius": _text(size[0])}
    elif kind in ("CYLINDER", "CAPSULE"):
        tag, attributes = "cylinder", {"radius": _text(size[0]), "length": _text(2 * size[1])}
    elif kind == "MESH":  # the compiler moved its vertices
        tag, attributes = "mesh", {"filename": meshes[mesh], "scale": _text(model.mesh_scale[mesh])}
        pose = pose @ np.linalg.inv(_pose(model.mesh_pos[mesh], model.mesh_quat[mesh]))
    else:
        return
    visual = ElementTree.SubElement(link, "visual")
    ElementTree.SubElement(visual, "origin", xyz=_text(pose[:3, 3]), rpy=_text(rpy_of(pose[:3, :3])))
    ElementTree.SubElement(ElementTree.SubElement(visual, "geometry"), tag, attributes)
    material = model.geom_matid[geom]
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    ElementTree.SubElement(ElementTree.SubElement(visual, "material", name=f"{geom}"), "color", rgba=_text(rgba))


def _pose(position: ArrayLike, quaternion: ArrayLike = (1.0, 0.0, 0.0, 0.0)) -> Array:
    """Return the pose (4, 4) of a frame at a position (3,) with an orientation (4,), scalar first."""
    pose, rotation = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(quaternion, dtype=float))
    pose[:3, :3], pose[:3, 3] = rotation.reshape(3, 3), position
    return pose


def rpy_of(rotation: Array) -> Array:
    """Return roll, pitch, yaw (3,) [rad] of R = R_z(yaw) R_y(pitch) R_x(roll), to rounding at any pitch."""
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    across = np.array([-np.sin(yaw), np.cos(yaw)]) @ rotation[:2]  # (.., cos(roll), -sin(roll))
    return np.array([np.arctan2(-across[2], across[1]), pitch, yaw])


def _text(numbers: ArrayLike) -> str:
    """Return numbers with all their digits."""
    return " ".join(map(repr, np.asarray(numbers, dtype=float).ravel().tolist()))
