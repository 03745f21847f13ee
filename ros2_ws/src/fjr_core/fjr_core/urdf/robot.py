# SPDX-License-Identifier: Apache-2.0
"""Build a flexible-joint robot from a URDF and joint elasticity data; links that do not move apart are one body."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from ..errors import RobotError
from ..model.joints import JointLimits
from ..model.newton_euler import serial_chain
from ..model.planar_arms import URDF_ARM
from ..model.rigid_arm import ArmDynamics, Body
from ..model.robot import Robot
from ..numerics import checks
from ..numerics.checks import Array
from .tree import MOVING, LinkInertia, UrdfJoint, UrdfTree, read_urdf

_log = logging.getLogger("fjr_core.model")
BASE = ""
"""Name of the joint in front of all named ones, which carries what never moves."""
WIDEST = 5.0  # m, radius of gyration
IN_SI, UNLIMITED = 50.0, 5000.0  # m, rad; a number between them is in millimetres or degrees
MOST_CONTROLLED = 64
"""Largest number of joints; the size of the law's expressions grows with its square."""


class MasslessJointError(RobotError):
    """A joint that can move without moving mass; joint: its name."""

    def __init__(self, joint: str) -> None:
        super().__init__(
            f"joint '{joint}' can move without moving mass (M_l is singular); "
            "expected links with mass and inertia beyond it"
        )
        self.joint = joint


def robot_from_urdf(
    path_or_xml: str | os.PathLike[str],
    joints: Sequence[str],
    stiffness: ArrayLike,
    motor_inertia: ArrayLike,
    link_damping: ArrayLike = URDF_ARM["link_damping"],
    motor_damping: ArrayLike = URDF_ARM["motor_damping"],
    gravity: ArrayLike = URDF_ARM["gravity_vector"],
    *,
    gear_ratio: ArrayLike = URDF_ARM["gear_ratio"],
    locked: Mapping[str, float] | None = None,
    input_gain: ArrayLike = URDF_ARM["input_gain"],
) -> Robot:
    """Return the robot of the n named joints, in this order; every other joint of the URDF is locked.

    path_or_xml: file, or XML text that starts with '<'. joints: names of revolute, continuous or prismatic joints
    that form one serial chain, in any order. gravity (3,) [m/s^2] in the frame of the root link.
    stiffness K [N m/rad], motor_inertia M_m [kg m^2], link_damping D_l, motor_damping D_m [N m s/rad] and
    input_gain B_m: scalar, (n,) or (n, n), in the named order and on the link side of the gear. With
    gear_ratio r, scalar or (n,), motor_inertia J is that of the rotor and M_m = r J r.
    locked: positions [rad, m] of joints that are not named, 0 by default; mimicking joints follow their leader.
    The limits of the URDF become robot.limits. Raises RobotError. A link with an invalid inertia that the named
    joints do not move is reported by a warning of the logger "fjr_core.model".
    """
    tree = read_urdf(path_or_xml)
    named = _named(tree, joints)
    _check_links(tree, joints)
    bodies = reduced_bodies(tree, joints, _locked_positions(tree, joints, dict(locked or {})))
    chain = list(bodies)
    links = serial_chain(list(bodies.values()), gravity, [chain.index(name) for name in joints])
    _check_inertia(links, chain)
    names = ("stiffness", "motor_inertia", "link_damping", "motor_damping", "input_gain")
    values = (stiffness, motor_inertia, link_damping, motor_damping, input_gain)
    matrices = zip(names, values, strict=True)
    K, M_m, D_l, D_m, B_m = (checks.matrix(name, value, len(chain), RobotError) for name, value in matrices)
    ratio = checks.vector("gear_ratio", gear_ratio, len(chain), RobotError)
    if not np.all(ratio != 0):
        raise RobotError(f"gear_ratio is {ratio.tolist()}; expected numbers other than 0")
    M_m = np.diag(ratio) @ M_m @ np.diag(ratio)
    limits = JointLimits(*np.array([joint.limits for joint in named]).T)
    prismatic = tuple(joint.kind == "prismatic" for joint in named)
    return Robot(links, M_m, K, D_l, D_m, B_m, limits, prismatic)


def _named(tree: UrdfTree, joints: Sequence[str]) -> list[UrdfJoint]:
    checks.joint_names("joints", joints, RobotError)
    if len(joints) > MOST_CONTROLLED:
        raise RobotError(f"joints has {len(joints)} names; expected at most {MOST_CONTROLLED}")
    for name in joints:
        joint = tree.joint(name)
        if joint.mimics:
            raise RobotError(f"joint '{name}' mimics '{joint.mimics[0]}'; expected joints that move by themselves")
        if joint.kind not in MOVING:
            raise RobotError(f"joint '{name}' is {joint.kind}; expected a {', '.join(MOVING)} joint")
        lower, upper, *_ = joint.limits
        if any(IN_SI < abs(value) < UNLIMITED for value in (*joint.xyz, *joint.rpy, lower, upper)):
            where = f"the origin {joint.xyz} m, {joint.rpy} rad and limits of {lower:g} and {upper:g}"
            _warn(f"joint '{name}' has {where}; expected m and rad, at most {IN_SI:g}")
    return [tree.joints[name] for name in joints]


def _check_links(tree: UrdfTree, joints: Sequence[str]) -> None:
    """Raise RobotError for an invalid inertia of a link that the joints move; warn, once in a process, of others.

    Also warn of one that no body has: the largest of its principal inertias exceeds the sum of the others, unless it is
    the only one, as of planar arms; and of one with a radius of gyration beyond WIDEST.
    """
    moved = tree.moved_by(joints)
    for link in sorted(moved & tree.inertias.keys()):
        *others, largest = np.linalg.eigvalsh(tree.inertias[link].inertia)
        if 0 < sum(others) < 0.99 * largest:
            _warn(
                f"link '{link}' has principal inertias of {others[0]:.3g}, {others[1]:.3g} and {largest:.3g} kg m^2; "
                "expected the largest to be at most the sum of the others"
            )
        mass = tree.inertias[link].mass
        if largest > WIDEST**2 * mass > 0:
            _warn(
                f"link '{link}' has {mass:.3g} kg and an inertia of {largest:.3g} kg m^2, a radius of gyration of "
                f"{np.sqrt(largest / mass):.3g} m; expected at most {WIDEST:g} m"
            )
    for link, fault in tree.faulty.items():
        if link in moved:
            raise RobotError(fault)
    if tree.faulty:
        which = "it" if len(tree.faulty) == 1 else "them"
        _warn(f"{'; '.join(tree.faulty.values())}; ignored, since no chosen joint moves {which}")


@cache
def _warn(sentence: str) -> None:
    _log.warning(sentence)


def _locked_positions(tree: UrdfTree, joints: Sequence[str], locked: dict[str, float]) -> dict[str, float]:
    """Return the positions of all moving joints that are not named."""
    for name, position in locked.items():
        joint = tree.joint(name)
        if name in joints:
            raise RobotError(f"joint '{name}' is named and locked; expected one of the two")
        if joint.mimics or joint.kind not in MOVING:
            what = f"mimics '{joint.mimics[0]}'" if joint.mimics else f"is {joint.kind}"
            raise RobotError(f"locked joint '{name}' {what}; expected a joint that moves by itself")
        checks.vector(f"position of locked joint '{name}'", [position], 1, RobotError)
    moving = [joint for joint in tree.joints.values() if joint.kind in MOVING and joint.name not in joints]
    return {joint.name: tree.position(joint, locked, joints) for joint in moving}


def reduced_bodies(tree: UrdfTree, joints: Sequence[str], locked: Mapping[str, float]) -> dict[str, Body]:
    """Return the body that each named joint moves, by joint from base to tip; raise RobotError if they branch.

    A body consists of the links between its joint and the next named ones. locked: positions [rad, m] of the other
    moving joints.
    """
    poses = {name: joint.pose(locked.get(name, 0.0)) for name, joint in tree.joints.items()}

    def carried(link: str) -> tuple[str, Array]:
        """Return the named joint that carries a link, or BASE, and the pose (4, 4) of the link in its frame."""
        pose = np.eye(4)
        for joint in tree.above(link):
            if joint.name in joints:
                return joint.name, pose
            pose = poses[joint.name] @ pose
        return BASE, pose

    parts: dict[str, list[LinkInertia]] = {name: [] for name in (BASE, *joints)}
    for link, inertia in tree.inertias.items():
        name, pose = carried(link)
        parts[name].append(inertia.moved(pose))
    before = {name: carried(tree.joints[name].parent) for name in joints}
    chain = _chain({name: carrier for name, (carrier, _) in before.items()})
    return {name: _body(tree.joints[name], before[name][1] @ poses[name], parts[name]) for name in chain}


def _chain(before: Mapping[str, str]) -> list[str]:
    """Return the joints in order from base to tip; before: the joint before each one."""
    chain = [BASE]
    while after := [name for name, joint in before.items() if joint == chain[-1]]:
        if len(after) > 1:
            both, where = f"'{after[0]}' and '{after[1]}'", chain[-1] or "the base"
            raise RobotError(f"joints {both} are on different branches after {where}; expected one serial chain")
        chain += after
    return chain[1:]


def _body(joint: UrdfJoint, pose: Array, parts: Sequence[LinkInertia]) -> Body:
    """Return a joint at its pose (4, 4) in the frame of the joint before, with the parts as one body.

    m = sum m_i, m c = sum m_i c_i, I = sum I_i + m_i (d_i'd_i E - d_i d_i') with d_i = c_i - c (parallel axes).
    """
    mass = sum(part.mass for part in parts)
    com = sum((part.mass * part.com for part in parts), np.zeros(3)) / (mass or 1.0)
    inertia = np.zeros((3, 3))
    for part in parts:
        d = part.com - com
        inertia += part.inertia + part.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return Body(pose[:3, :3], pose[:3, 3], joint.axis, mass, com, inertia, joint.kind == "prismatic")


def _check_inertia(links: ArmDynamics, chain: list[str]) -> None:
    """Raise MasslessJointError with the outermost joint if the inertia is singular in one of a few configurations."""
    place = np.argsort(links.order)  # of each joint of the chain among the named ones
    for q in (np.zeros(links.n), np.linspace(0.3, 1.4, links.n), np.linspace(-1.2, 0.7, links.n)):
        M_l = links.M_l(q).full()[np.ix_(place, place)]
        for i in reversed(range(links.n)):
            if not np.linalg.eigvalsh(M_l[i:, i:])[0] > 1e-14 * np.max(M_l[i:, i:]):
                raise MasslessJointError(chain[i])
