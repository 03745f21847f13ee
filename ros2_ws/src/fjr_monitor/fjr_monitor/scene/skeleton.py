# SPDX-License-Identifier: Apache-2.0
"""Skeleton of links: capsules between the origins of their joints, and cylinders along the joint axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

THICKNESS, THIN = 0.03, 0.012  # radius of a capsule, relative to the reach of the arm; THIN: inside other shapes
SMALLEST, STANDARD = 1e-3, 1.0  # m, shortest capsule; reach of an arm without lengths


def skeleton(
    joints: Sequence[Mapping[str, Any]], tips: Mapping[str, Sequence[float] | None], thickness: float = THICKNESS
) -> dict[str, list[dict[str, Any]]]:
    """Return the shapes of the links in `tips`, in their frames, as values for arm.js.

    joints: those of the scene. tips: where each link to draw ends if it has no further joint (3,) [m]; None: not known.
    thickness: radius of a capsule, relative to the reach of the arm.
    """
    ends: dict[str, list[Sequence[float]]] = {name: [] for name in tips}
    for joint in joints:
        if joint["parent"] in ends:
            ends[joint["parent"]].append(joint["xyz"])
    for name, tip in tips.items():
        if not ends[name] and tip is not None:
            ends[name].append(tip)
    reach = sum(float(np.linalg.norm(joint["xyz"])) for joint in joints)
    reach += sum(float(np.linalg.norm(each)) for points in ends.values() for each in points) / max(1, len(joints))
    radius = thickness * (reach or STANDARD)
    shapes = {name: [_capsule(end, radius) for end in points if _long(end)] for name, points in ends.items()}
    for joint in joints:
        if joint["child"] in shapes and joint["kind"] != "fixed":
            shapes[joint["child"]].append(_hub(joint["axis"], radius))
    return shapes


def _long(end: Sequence[float]) -> bool:
    return float(np.linalg.norm(end)) > SMALLEST


def _capsule(end: Sequence[float], radius: float) -> dict[str, Any]:
    return {"kind": "capsule", "size": [radius], "to": [float(each) for each in end], "colour": None}


def _hub(axis: Sequence[float], radius: float) -> dict[str, Any]:
    """Return the cylinder along the axis of a joint, about the origin of its child."""
    along = 3.0 * radius * np.asarray(axis) / np.linalg.norm(axis)
    return {"kind": "hub", "size": [1.5 * radius], "to": [float(each) for each in along], "colour": None}
