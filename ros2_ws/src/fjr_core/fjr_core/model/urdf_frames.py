# SPDX-License-Identifier: Apache-2.0
"""Transforms between the link frames of a URDF at given joint positions."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..numerics.checks import Array
from .urdf_parser import UrdfJoint, read_urdf


@dataclass(frozen=True, eq=False)
class Frame:
    """Pose of the frame of link `child` in that of link `parent`: translation (3,) [m], quaternion (4,) x, y, z, w."""

    parent: str
    child: str
    translation: Array
    quaternion: Array


class UrdfFrames:
    """Relative poses of all links of a URDF. Raises RobotError for an invalid URDF."""

    def __init__(self, urdf: str) -> None:
        """urdf: XML text."""
        tree = read_urdf(urdf)
        self._joints = list(tree.joints.values())
        origins = {each.get("name", ""): each.find("origin") for each in ET.fromstring(tree.skeleton).iter("joint")}
        self._origin = np.array([_numbers(origins[each.name], "xyz") for each in self._joints])
        rpy = np.array([_numbers(origins[each.name], "rpy") for each in self._joints])
        self._rotation = Rotation.from_euler("xyz", rpy)
        self._axis = np.array([np.array(each.axis) / (np.linalg.norm(each.axis) or 1.0) for each in self._joints])
        self._slides = np.array([each.kind == "prismatic" for each in self._joints])

    def at(self, positions: Mapping[str, float]) -> list[Frame]:
        """Return the pose of each child link, in the order of the joints.

        positions [rad, m] by joint; 0 for joints without one, other names are ignored.
        """
        motion = self._axis * np.array([_position(each, positions) for each in self._joints])[:, None]
        shift = self._rotation.apply(np.where(self._slides[:, None], motion, 0.0))
        turn = Rotation.from_rotvec(np.where(self._slides[:, None], 0.0, motion))
        quaternions = (self._rotation * turn).as_quat()
        return [
            Frame(joint.parent, joint.child, translation, quaternion)
            for joint, translation, quaternion in zip(self._joints, self._origin + shift, quaternions, strict=True)
        ]


def _position(joint: UrdfJoint, positions: Mapping[str, float]) -> float:
    if joint.kind == "fixed":
        return 0.0
    if joint.mimics is None:
        return positions.get(joint.name, 0.0)
    leader, multiplier, offset = joint.mimics
    return multiplier * positions.get(leader, 0.0) + offset


def _numbers(origin: ET.Element | None, name: str) -> list[float]:
    return [float(word) for word in ("0 0 0" if origin is None else origin.get(name, "0 0 0")).split()]
