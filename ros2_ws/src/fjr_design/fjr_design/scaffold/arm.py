# SPDX-License-Identifier: Apache-2.0
"""Choose the joints of a URDF that a scenario moves, and build the robot with published or guessed joint data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from ament_index_python.packages import get_package_share_directory

from fjr_core.errors import RobotError
from fjr_core.model.robot import Robot
from fjr_core.urdf.robot import MasslessJointError, robot_from_urdf
from fjr_core.urdf.tree import MOVING, UrdfTree, read_urdf
from fjr_core.urdf.typical_joints import joints_without_inertia, typical_joints

from .chains import Chain, chains

PUBLISHED = "config/joint_data.yaml"


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm of a URDF: the joints that move, the robot, and what of it is known.

    locked: positions of the other joints [rad, m]. guesses: guessed values (n,) by name, 0 where published ones are
    used. source: of these. chains: all that the URDF has. notes: a sentence for each choice that was made.
    """

    urdf: Path
    joints: tuple[str, ...]
    robot: Robot
    locked: dict[str, float]
    guesses: dict[str, tuple[float, ...]]
    source: str
    chains: tuple[Chain, ...]
    notes: tuple[str, ...]


def arm_of(urdf: Path, joints: Sequence[str] = (), chain: int | None = None) -> Arm:
    """Return the arm of the named joints, else of a chain by its number from 1, else of the longest chain.

    Joints of the chain's end that carry no inertia are locked. Raises RobotError.
    """
    tree = read_urdf(urdf)
    found = tuple(chains(tree))
    chosen = tuple(joints) or _chain(found, chain).joints
    rigid, moving, notes = _rigid(urdf, tree, chosen, drop=not joints)
    robot, guesses, source = _with_joint_data(rigid, moving)
    return Arm(urdf, moving, robot, _locked(tree, moving), guesses, source, found, notes)


def _chain(found: Sequence[Chain], number: int | None) -> Chain:
    if not found:
        raise RobotError("the URDF has no chain of joints that move by themselves, except grippers; expected an arm")
    if number is not None and number > len(found):
        raise RobotError(f"the URDF has no chain {number}; expected 1 to {len(found)}: {'; '.join(described(found))}")
    return found[(number or 1) - 1]


def described(found: Sequence[Chain], most: int = 6) -> list[str]:
    """Return a line for each chain: number, joints, tip; the last line counts what is left out."""
    lines = [
        f"{i}: {len(each.joints)} joints, {each.joints[0]} to {each.joints[-1]}" for i, each in enumerate(found, 1)
    ]
    return lines if len(lines) <= most else [*lines[:most], f"and {len(lines) - most} more"]


def _rigid(
    urdf: Path, tree: UrdfTree, joints: tuple[str, ...], drop: bool
) -> tuple[Robot, tuple[str, ...], tuple[str, ...]]:
    """Return the robot with placeholder joint data, its joints, and a note if joints without inertia were dropped.

    drop: lock the first joint without inertia and those beyond it, instead of raising RobotError.
    """
    kept = joints
    notes: tuple[str, ...] = ()
    while True:
        try:
            robot = robot_from_urdf(urdf, kept, 1.0, 1.0, locked=_locked(tree, kept))
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


def _with_joint_data(rigid: Robot, joints: Sequence[str]) -> tuple[Robot, dict[str, tuple[float, ...]], str]:
    """Return the robot with stiffness and motor inertia, the guesses among them, and the source of the others."""
    typical, known = typical_joints(rigid), published(joints)
    values, guesses = {}, {}
    for name, guess in (("joint_stiffness", typical.stiffness), ("motor_inertia", typical.motor_inertia)):
        data = dict(zip(map(str, known["joints"]), known[name], strict=True)) if name in known else {}
        values[name] = np.array([data.get(joint, own) for joint, own in zip(joints, guess, strict=True)])
        guesses[name] = tuple(0.0 if joint in data else float(own) for joint, own in zip(joints, guess, strict=True))
    robot = replace(rigid, K=np.diag(values["joint_stiffness"]), M_m=np.diag(values["motor_inertia"]))
    return robot, {name: each for name, each in guesses.items() if any(each)}, known.get("source", "")


def published(joints: Sequence[str]) -> dict[str, Any]:
    """Return the entry of joint_data.yaml of the first robot that has all these joints; empty if there is none.

    It has `joints`, `source` and `motor_inertia`, `joint_stiffness` or both, each in the order of its joints.
    """
    text = Path(get_package_share_directory("fjr_bringup"), PUBLISHED).read_text(encoding="utf-8")
    return next((entry for entry in yaml.safe_load(text) if set(joints) <= set(entry["joints"])), {})
