# SPDX-License-Identifier: Apache-2.0
"""Read an MJCF arm through MuJoCo: its bodies as a URDF, and what a URDF lacks, motor inertia and stiffness.

MuJoCo's compiler resolves defaults, included files, orientations and inertia from shapes, its kinematics anchors and
references of joints: all poses are those at q = 0. In a file of `fjr export-mjcf` rotors and springs are recognised.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import RobotError
from fjr_core.numerics.checks import MOTOR, Array
from fjr_core.urdf.tree import INERTIA
from fjr_design.scaffold.files import path_from

from .writing import SPRING, pose_of, refusals

AT_JOINTS = int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)
OF_MOTOR = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtBias.mjBIAS_NONE)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
JOINTS = {int(mujoco.mjtJoint.mjJNT_HINGE): "revolute", SLIDE: "prismatic"}
Element = ElementTree.Element
UNREAD = {
    "stiffness of joints": ("jnt_stiffness", "jnt_stiffnesspoly"),
    "damping of joints that is not linear": ("dof_dampingpoly",),
    "damping of actuators": ("actuator_damping", "actuator_dampingpoly"),
    "dynamics of actuators (filters, integrators, muscles)": ("actuator_dyntype",),
    "feedback of actuators (position, velocity, muscles)": ("actuator_gaintype", "actuator_biastype"),
    "gravcomp of bodies": ("body_gravcomp",),
    "deformable bodies (flex)": ("nflex",),
    "drag (density, viscosity)": ("opt.density", "opt.viscosity"),
}
"""What moves the arm in MuJoCo, but neither URDF nor joint data hold, by fields of its model."""


def read_mjcf(file: Path, folder: Path) -> tuple[str, dict[str, Any]]:
    """Return an arm as the text of a URDF for this folder, with its `gravity` and what is known of its joints.

    The latter has the form of an entry of joint_data.yaml, with 0 for what is not known. Raises RobotError for a file
    that MuJoCo refuses, and for free and ball joints, tendons other than our springs, and equality constraints.
    """
    with refusals("an MJCF that it loads"):
        spec = mujoco.MjSpec.from_file(str(file))
        for kind, elements in (("body", spec.bodies), ("joint", spec.joints), ("equality", spec.equalities)):
            for k, each in enumerate(elements):
                each.name = each.name or f"{kind}{k}"
        model = spec.compile()
    if not model.njnt:
        raise RobotError("the MJCF has no joint; expected an arm of hinges and slides")
    springs = springs_of(model)
    names = [model.joint(joint).name for joint in range(model.njnt)]
    rotors = {joint + MOTOR for joint in springs}
    drives = {name: name + MOTOR if name in springs else name for name in names if name not in rotors}
    weightless = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    known = {
        "joints": list(drives),
        "source": file.name,
        "motor_inertia": [_motor_inertia(model, drive) for drive in drives.values()],
        "joint_stiffness": [springs.get(name, 0.0) for name in drives],
        "gravity": [0.0] * 3 if weightless else model.opt.gravity.tolist(),
    }
    unread = [what for what, names in UNREAD.items() if any(np.any(attrgetter(name)(model)) for name in names)]
    elsewhere = ~np.isin(model.actuator_trntype, [*AT_JOINTS, int(mujoco.mjtTrn.mjTRN_TENDON)])
    unread += ["actuators at sites, bodies or cranks"] if elsewhere.any() else []
    unread += ["plugins"] if np.any(np.append(model.body_plugin, model.actuator_plugin) >= 0) else []  # -1: none
    unread += [f"armature of {name} beside that of its rotor" for name in springs if model.joint(name).armature]
    known["notes"] = [f"not read, though they act in MuJoCo: {', '.join(unread)}"] if unread else []
    paths = [model.paths[start:].partition(b"\0")[0].decode() if start >= 0 else "" for start in model.mesh_pathadr]
    meshes = [path_from(folder, Path(path)) if path else "" for path in paths]
    return urdf(model, drives, spec.modelname or file.stem, meshes), known


def springs_of(model: mujoco.MjModel) -> dict[str, float]:
    """Return the stiffness [N m/rad] behind each joint that has a spring; raise RobotError for other couplings.

    A spring is a fixed tendon `<joint>_spring` of the length q_m - q_l. A tendon that exerts no force may stay.
    """
    for joint in map(model.joint, np.flatnonzero(~np.isin(model.jnt_type, list(JOINTS)))):
        body, ball = model.body(joint.bodyid[0]).name, joint.type[0] == int(mujoco.mjtJoint.mjJNT_BALL)
        raise RobotError(f"body '{body}' has a {'ball' if ball else 'free'} joint; expected hinges and slides only")
    for constraint in map(model.eq, np.flatnonzero(model.eq_active0)):
        raise RobotError(
            f"equality constraint '{constraint.name}' couples bodies or joints (a closed chain); expected an arm whose "
            "joints move by themselves"
        )
    springs = {}
    for tendon in filter(lambda tendon: _pulls(model, tendon), range(model.ntendon)):
        name, parts = model.tendon(tendon).name, model.tendon_adr[tendon] + np.arange(model.tendon_num[tendon])
        fixed = parts[model.wrap_type[parts] == int(mujoco.mjtWrap.mjWRAP_JOINT)]
        ends = {model.joint(model.wrap_objid[part]).name: model.wrap_prm[part] for part in fixed}
        joint = name.removesuffix(SPRING)
        more = *model.tendon_stiffnesspoly[tendon], model.tendon_damping[tendon], *model.tendon_lengthspring[tendon]
        if ends != {joint: -1.0, joint + MOTOR: 1.0} or any(more):
            raise RobotError(f"'{name}' is a tendon; expected joints without tendons, or the springs of our export")
        springs[joint] = float(model.tendon_stiffness[tendon])
    return springs


def _pulls(model: mujoco.MjModel, tendon: int) -> bool:
    """Return whether a tendon exerts a force, by itself or by an actuator."""
    moves = model.actuator_trnid[model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON), 0]
    forces = ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "frictionloss", "armature", "limited")
    return tendon in moves or any(np.any(getattr(model, f"tendon_{force}")[tendon]) for force in forces)


def effort_limit(model: mujoco.MjModel, joint: str) -> float:
    """Return the largest effort [N m] of all actuators of a joint in both directions, or in one; 0: no limit."""
    given, together = model.joint(joint), sum(map(_largest_effort, _actuators(model, joint)))
    ends = [-1.0, 1.0] * model.jnt_actfrcrange[given.id] if model.jnt_actfrclimited[given.id] else []
    return float(min(filter(None, [together, *ends]), default=0.0))


def _largest_effort(actuator: Any) -> float:
    """Return the largest effort [N m] of an actuator in both directions, or in one; 0: no limit."""
    found = [*actuator.forcerange] if actuator.forcelimited[0] else []
    if actuator.ctrllimited[0] and (actuator.gaintype[0], actuator.biastype[0]) == OF_MOTOR:
        found += [*(actuator.gainprm[0] * actuator.ctrlrange)]
    return float(abs(actuator.gear[0]) * min(filter(None, np.abs(found)), default=0.0))


def _motor_inertia(model: mujoco.MjModel, joint: str) -> float:
    """Return the armature at a joint [kg m^2] and that of its actuators, reflected by the gear."""
    motors = [actuator.id for actuator in _actuators(model, joint)]
    reflected = model.actuator_gear[motors, 0] ** 2 * model.actuator_armature[motors]
    return float(model.joint(joint).armature[0] + reflected.sum())


def _actuators(model: mujoco.MjModel, joint: str) -> list[Any]:
    here = np.isin(model.actuator_trntype, AT_JOINTS) & (model.actuator_trnid[:, 0] == model.joint(joint).id)
    return [model.actuator(actuator) for actuator in np.flatnonzero(here)]


def urdf(model: mujoco.MjModel, drives: Mapping[str, str], name: str, meshes: Sequence[str]) -> str:
    """Return the text of a URDF. The frame of a link is at the anchor of its joint, and is turned as the body.

    drives: for each joint of a link, that at which its motor acts. meshes: the path of each mesh, "" without a file.
    """
    data, robot = mujoco.MjData(model), ElementTree.Element("robot", name=name)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    frames: dict[int, Array] = {}
    for body in map(model.body, range(model.nbody)):
        joints = [model.joint(body.jntadr[0] + k) for k in range(body.jntnum[0])]
        if any(joint.name not in drives for joint in joints):
            continue  # a rotor
        link, before = model.body(body.parentid[0]).name, frames.get(body.parentid[0], np.eye(4))
        frame = frames[body.id] = pose_of(data.xpos[body.id], data.xmat[body.id])
        for joint in joints:
            parent, link = link, body.name if joint.id == joints[-1].id else f"{body.name}_{joint.name}"
            if link != body.name:
                _add(robot, "link", name=link)
            frame[:3, 3] = data.xanchor[joint.id]
            kind = JOINTS[joint.type[0]] if joint.limited[0] or joint.type[0] == SLIDE else "continuous"
            element = _add_joint(robot, joint.name, kind, (parent, link), np.linalg.inv(before) @ frame)
            _add(element, "axis", xyz=_text(data.xaxis[joint.id] @ frame[:3, :3]))
            lower, upper = joint.range if joint.limited[0] else (0.0, 0.0)
            effort = effort_limit(model, drives[joint.name])
            _add(element, "limit", lower=_text(lower), upper=_text(upper), velocity="0.0", effort=_text(effort))
            _add(element, "dynamics", damping=_text(joint.damping[0]), friction=_text(joint.frictionloss[0]))
            before = frame.copy()
        if body.id and not joints:
            _add_joint(robot, f"{body.name}_fixed", "fixed", (link, body.name), np.linalg.inv(before) @ frame)
        _add_link(robot, model, data, body, frame, meshes)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _add_joint(robot: Element, name: str, kind: str, links: tuple[str, str], pose: Array) -> Element:
    joint = _add(robot, "joint", name=name, type=kind)
    _add(joint, "parent", link=links[0])
    _add(joint, "child", link=links[1])
    _add_origin(joint, pose)
    return joint


def _add_link(
    robot: Element, model: mujoco.MjModel, data: mujoco.MjData, body: Any, frame: Array, meshes: Sequence[str]
) -> None:
    """Add a link with its inertia and the geoms that show it: those that never touch anything, else all.

    frame (4, 4): pose of the link in the world.
    """
    link, to_link = _add(robot, "link", name=body.name), np.linalg.inv(frame)
    if body.mass[0]:
        pose = to_link @ pose_of(data.xipos[body.id], data.ximat[body.id])
        J = pose[:3, :3] @ np.diag(body.inertia) @ pose[:3, :3].T
        inertial = _add(link, "inertial")
        _add(inertial, "origin", xyz=_text(pose[:3, 3]))
        _add(inertial, "mass", value=_text(body.mass))
        _add(inertial, "inertia", **dict(zip(INERTIA, map(_text, J[np.triu_indices(3)]), strict=True)))
    geoms = [model.geom(body.geomadr[0] + k) for k in range(body.geomnum[0])]
    for geom in [geom for geom in geoms if not (geom.contype[0] or geom.conaffinity[0])] or geoms:
        _add_visual(link, model, geom, to_link @ pose_of(data.geom_xpos[geom.id], data.geom_xmat[geom.id]), meshes)


def _add_visual(link: Element, model: mujoco.MjModel, geom: Any, pose: Array, meshes: Sequence[str]) -> None:
    """Add the shape of a geom with this pose in the link, if a URDF has it; a capsule is a cylinder."""
    kind, size, mesh = mujoco.mjtGeom(int(geom.type[0])).name.removeprefix("mjGEOM_"), geom.size, geom.dataid[0]
    if kind == "BOX":
        shape = "box", {"size": _text(2 * size)}
    elif kind == "SPHERE":
        shape = "sphere", {"radius": _text(size[0])}
    elif kind in ("CYLINDER", "CAPSULE"):
        shape = "cylinder", {"radius": _text(size[0]), "length": _text(2 * size[1])}
    elif kind == "MESH" and meshes[mesh]:  # the compiler moved its vertices
        shape = "mesh", {"filename": meshes[mesh], "scale": _text(model.mesh_scale[mesh])}
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.mesh_quat[mesh])
        pose = pose @ np.linalg.inv(pose_of(model.mesh_pos[mesh], turn))
    else:
        return
    visual = _add(link, "visual")
    _add_origin(visual, pose)
    _add(_add(visual, "geometry"), shape[0], **shape[1])
    material = geom.matid[0]
    rgba = geom.rgba if material < 0 else model.mat_rgba[material]
    _add(_add(visual, "material", name=f"{geom.id}"), "color", rgba=_text(rgba))


def _add_origin(owner: Element, pose: Array) -> None:
    """Add a pose (4, 4) to a joint or a visual: R = R_z(yaw) R_y(pitch) R_x(roll), to rounding at any pitch."""
    R = pose[:3, :3]
    yaw, pitch = np.arctan2(R[1, 0], R[0, 0]), np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    across = np.array([-np.sin(yaw), np.cos(yaw)]) @ R[:2]  # (.., cos(roll), -sin(roll))
    _add(owner, "origin", xyz=_text(pose[:3, 3]), rpy=_text([np.arctan2(-across[2], across[1]), pitch, yaw]))


def _add(owner: Element, tag: str, **attributes: str) -> Element:
    return ElementTree.SubElement(owner, tag, attributes)


def _text(numbers: ArrayLike) -> str:
    """Return numbers with all their digits."""
    return " ".join(map(repr, np.asarray(numbers, dtype=float).ravel().tolist()))
