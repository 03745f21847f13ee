# SPDX-License-Identifier: Apache-2.0
"""Choose the joints of a URDF that a scenario moves, and build the robot with published or guessed joint data.

The joints are those of a serial chain from the base to a tip, without grippers and hands.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from ament_index_python.packages import get_package_share_directory

from fjr_core.errors import RobotError
from fjr_core.files.text_file import read_bytes
from fjr_core.model.planar_arms import URDF_ARM
from fjr_core.model.robot import Robot
from fjr_core.urdf.robot import MasslessJointError, robot_from_urdf
from fjr_core.urdf.tree import MOVING, UrdfTree, read_urdf
from fjr_core.urdf.typical_joints import joints_without_inertia, typical_joints

PUBLISHED = "config/joint_data.yaml"
HAND = re.compile(
    r"finger|gripper|thumb|knuckle|jaw|claw|grasp|allegro|(?:^|_)hand_|(?:index|middle|ring|little|pinky)_?(?:\d|joint|prox|dist|inter|mid)"
    r"|(?:^|[_/])(?:wheel|caster)s?(?:[_/\d]|$)",
    re.IGNORECASE,
)
"""Names of joints that belong to a gripper, a hand or a wheel."""
UNREAD = {
    r"<dynamics\b[^>]*[1-9]": "<dynamics> is not read: enter damping as motor_damping, friction as imperfections",
    r"<mechanical_?[rR]eduction>\s*(?!\s|1(\.0*)?\s*<)": "<transmission> is not read: enter it as gear_ratio",
    r"<safety_controller\b[^>]*soft_": "<safety_controller> is not read: enter its limits as limits.link_position_*",
    r"<(drake:)?rotor_inertia\b": "<rotor_inertia> is not read: enter it as motor_inertia, with gear_ratio",
}
"""A note for each kind of number on joints in a URDF that the robot file has to hold instead."""
LARGEST_FINGER = 4  # joints; a branch with at most as many on each side is a hand, a larger one two arms
Chain = tuple[str, ...]  # joints of a serial chain from the base to the tip


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm of a URDF: the joints that move, the robot, and what of it is known.

    locked: positions of the other joints [rad, m]. guesses: guessed values (n,) by name, 0 where known ones are used.
    source: of these. chains: all that the URDF has. notes: a sentence for each choice that was made. gravity [m/s^2].
    """

    urdf: Path
    joints: Chain
    robot: Robot
    locked: dict[str, float]
    guesses: dict[str, tuple[float, ...]]
    source: str
    chains: tuple[Chain, ...]
    notes: tuple[str, ...]
    gravity: tuple[float, ...] = URDF_ARM["gravity_vector"]


def arm_of(
    urdf: Path,
    joints: Sequence[str] = (),
    chain: int | None = None,
    text: str | None = None,
    known: Mapping[str, Any] | None = None,
) -> Arm:
    """Return the arm of the named joints, else of a chain by its number from 1, else of the longest chain.

    text: of a URDF that is not written yet. known: `gravity`, `notes`, and an entry of joint_data.yaml that replaces
    that of the published data, 0 where a value is not known.
    Joints of the chain's end that carry no inertia are locked. Raises RobotError.
    """
    tree, gravity = read_urdf(text or urdf), (known or {}).get("gravity", Arm.gravity)
    found = tuple(chains(tree))
    chosen = tuple(joints) or _chain(tree, found, chain)
    rigid, moving, notes = _rigid(text or urdf, tree, chosen, gravity, drop=not joints)
    robot, guesses, source = _with_joint_data(rigid, moving, known or published(moving))
    content = re.sub(r"<!--.*?-->", "", text or read_bytes(urdf).decode(errors="replace"), flags=re.DOTALL)
    notes += tuple((known or {}).get("notes", ()))
    notes += tuple(note for pattern, note in UNREAD.items() if re.search(pattern, content))
    return Arm(urdf, moving, robot, _locked(tree, moving), guesses, source, found, notes, tuple(gravity))


def _chain(tree: UrdfTree, found: Sequence[Chain], number: int | None) -> Chain:
    if not found:
        hand = max([*_paths(tree), ["A", "B"]], key=len)
        raise RobotError(f"the URDF moves nothing but grippers; expected an arm, or --joints {','.join(hand)}")
    if number is not None and number > len(found):
        raise RobotError(f"the URDF has no chain {number}; expected 1 to {len(found)}: {'; '.join(described(found))}")
    return found[(number or 1) - 1]


def described(found: Sequence[Chain], most: int = 6) -> list[str]:
    """Return a line for each chain: number, joints, tip; the last line counts what is left out."""
    lines = [f"{i}: {len(each)} joints, {each[0]} to {each[-1]}" for i, each in enumerate(found, 1)]
    return lines if len(lines) <= most else [*lines[:most], f"and {len(lines) - most} more"]


def _rigid(
    urdf: Path | str, tree: UrdfTree, joints: tuple[str, ...], gravity: Sequence[float], drop: bool
) -> tuple[Robot, tuple[str, ...], tuple[str, ...]]:
    """Return the robot with placeholder joint data, its joints, and a note if joints without inertia were dropped.

    drop: lock the first joint without inertia and those beyond it, instead of raising RobotError.
    """
    kept = joints
    notes: tuple[str, ...] = ()
    while True:
        try:
            robot = robot_from_urdf(urdf, kept, 1.0, 1.0, gravity=gravity, locked=_locked(tree, kept))
            thin = joints_without_inertia(robot)
            if not thin:
                return robot, kept, notes
            last = kept[min(thin)]
            seen = f"{last} {thin[min(thin)]}"
        except MasslessJointError as error:
            if not drop:
                raise
            last, seen = error.joint, ""
        if not drop:
            raise RobotError(f"{seen}; expected the inertia of its links in the URDF, or --joints without it")
        if last == kept[0]:
            raise RobotError(f"no link that joint '{last}' moves has an inertia; expected some")
        kept = kept[: kept.index(last)]
        lost = ", ".join(joints[len(kept) :])
        notes = (
            f"{seen}: {lost} locked, until the URDF has it"
            if seen
            else f"no link beyond {kept[-1]} has an inertia: {lost} locked",
        )


def _locked(tree: UrdfTree, moving: Sequence[str]) -> dict[str, float]:
    """Return a position for each other joint that moves by itself: 0, or the nearest one within its range."""
    others = [each for each in tree.joints.values() if each.kind in MOVING and not each.mimics]
    return {each.name: min(max(0.0, each.limits[0]), each.limits[1]) for each in others if each.name not in moving}


def _with_joint_data(
    rigid: Robot, joints: Sequence[str], known: Mapping[str, Any]
) -> tuple[Robot, dict[str, tuple[float, ...]], str]:
    """Return the robot with stiffness and motor inertia, the guesses among them, and the source of the others."""
    typical, values, guesses = typical_joints(rigid), {}, {}
    for name, guess in (("joint_stiffness", typical.stiffness), ("motor_inertia", typical.motor_inertia)):
        pairs = zip(map(str, known["joints"]), known[name], strict=True) if name in known else ()
        data = {joint: value for joint, value in pairs if value}
        values[name] = np.array([data.get(joint, own) for joint, own in zip(joints, guess, strict=True)])
        guesses[name] = tuple(0.0 if joint in data else float(own) for joint, own in zip(joints, guess, strict=True))
    robot = replace(rigid, K=np.diag(values["joint_stiffness"]), M_m=np.diag(values["motor_inertia"]))
    source = known.get("source", "") if any(0.0 in each for each in guesses.values()) else ""
    return robot, {name: each for name, each in guesses.items() if any(each)}, source


def published(joints: Sequence[str]) -> dict[str, Any]:
    """Return the entry of joint_data.yaml of the first robot that has all these joints; empty if there is none.

    It has `joints`, `source` and `motor_inertia`, `joint_stiffness` or both, each in the order of its joints.
    """
    text = Path(get_package_share_directory("fjr_bringup"), PUBLISHED).read_text(encoding="utf-8")
    return next((entry for entry in yaml.safe_load(text) if set(joints) <= set(entry["joints"])), {})


def chains(tree: UrdfTree) -> list[Chain]:
    """Return the chains of joints that move by themselves, the longest first, else in the order of the URDF.

    A chain ends before a gripper: before a joint named like one, or where it branches into fingers. A chain that is
    part of another one is left out.
    """
    found = list(dict.fromkeys(arm for path in _paths(tree) if (arm := _arm(tree, path))))
    beginnings = {arm[:k] for arm in found for k in range(len(arm))}
    return sorted((arm for arm in found if arm not in beginnings), key=lambda arm: -len(arm))


def _paths(tree: UrdfTree) -> Iterator[list[str]]:
    """Yield the joints that move by themselves on the way to each link without children."""
    parents = {joint.parent for joint in tree.joints.values()}
    for tip in [joint.child for joint in tree.joints.values() if joint.child not in parents]:
        path = [joint.name for joint in tree.above(tip) if joint.kind in MOVING and joint.mimics is None]
        if path:
            yield path[::-1]


def _arm(tree: UrdfTree, path: list[str]) -> Chain:
    """Return the part of a path before the first joint of a gripper."""
    for i, name in enumerate(path):
        if HAND.search(name) or (i > 0 and _is_finger(tree, path, i)):
            return tuple(path[:i])
    return tuple(path)


def _is_finger(tree: UrdfTree, path: list[str], i: int) -> bool:
    """Return True if the chain branches before joint i into short sides only."""
    if len(path) - i > LARGEST_FINGER:
        return False
    sides = [len(_descent(tree, name)) for name in _next_moving(tree, tree.joints[path[i - 1]].child)]
    return len(sides) > 1 and max(sides) <= LARGEST_FINGER


def _next_moving(tree: UrdfTree, link: str) -> list[str]:
    """Return the moving joints next to a link, across fixed joints; a mimicking joint counts."""
    found = []
    for joint in tree.joints.values():
        if joint.parent == link:
            found += [joint.name] if joint.kind in MOVING else _next_moving(tree, joint.child)
    return found


def _descent(tree: UrdfTree, name: str) -> list[str]:
    """Return the moving joints of the longest path that begins with this one."""
    beyond = [_descent(tree, other) for other in _next_moving(tree, tree.joints[name].child)]
    return [name, *max(beyond, key=len, default=[])]
