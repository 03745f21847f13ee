# SPDX-License-Identifier: Apache-2.0
"""Find the serial chains of a URDF, from the base to each tip, without the joints of grippers and hands."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from fjr_core.urdf.tree import MOVING, UrdfTree

HAND = re.compile(
    r"finger|gripper|thumb|knuckle|jaw|claw|grasp|allegro|(?:^|_)hand_|(?:index|middle|ring|little|pinky)_?(?:\d|joint|prox|dist|inter|mid)"
    r"|(?:^|[_/])(?:wheel|caster)s?(?:[_/\d]|$)",
    re.IGNORECASE,
)
"""Names of joints that belong to a gripper, a hand or a wheel."""
LARGEST_FINGER = 4
"""Most joints of a finger: a branch with at most as many joints on each side is a hand, a larger one two arms."""


@dataclass(frozen=True)
class Chain:
    """A serial chain: joints from the base to the tip, and the link that the last one carries."""

    joints: tuple[str, ...]
    tip: str


def chains(tree: UrdfTree) -> list[Chain]:
    """Return the chains of joints that move by themselves, the longest first, else in the order of the URDF.

    A chain ends before a gripper: before a joint named like one, or where it branches into fingers. A chain that is
    part of another one is left out.
    """
    found: dict[tuple[str, ...], Chain] = {}
    for path in _paths(tree):
        arm = _arm(tree, path)
        if arm:
            found.setdefault(arm, Chain(arm, tree.joints[arm[-1]].child))
    beginnings = {arm[:k] for arm in found for k in range(len(arm))}
    longest = [chain for joints, chain in found.items() if joints not in beginnings]
    return sorted(longest, key=lambda chain: -len(chain.joints))


def _paths(tree: UrdfTree) -> Iterator[list[str]]:
    """Yield the joints that move by themselves on the way to each link without children."""
    carriers = {joint.child: joint for joint in tree.joints.values()}
    parents = {joint.parent for joint in tree.joints.values()}
    for tip in carriers:
        if tip in parents:
            continue
        path, link = [], tip
        while link in carriers:
            joint = carriers[link]
            if joint.kind in MOVING and joint.mimics is None:
                path.append(joint.name)
            link = joint.parent
        if path:
            yield path[::-1]


def _arm(tree: UrdfTree, path: list[str]) -> tuple[str, ...]:
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
