# SPDX-License-Identifier: Apache-2.0
"""Transforms between the link frames of a URDF at given joint positions."""

from __future__ import annotations

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
        self._joints = list(read_urdf(urdf).joints.values())

    def at(self, positions: Mapping[str, float]) -> list[Frame]:
        """Return the pose of each child link, in the order of the joints.

        positions [rad, m] by joint; 0 for joints without one, other names are ignored.
        """
        poses = np.array([joint.pose(_position(joint, positions)) for joint in self._joints])
        quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
        return [
            Frame(joint.parent, joint.child, translation, quaternion)
            for joint, translation, quaternion in zip(self._joints, poses[:, :3, 3], quaternions, strict=True)
        ]


def _position(joint: UrdfJoint, positions: Mapping[str, float]) -> float:
    if joint.kind == "fixed":
        return 0.0
    if joint.mimics is None:
        return positions.get(joint.name, 0.0)
    leader, multiplier, offset = joint.mimics
    return multiplier * positions.get(leader, 0.0) + offset
