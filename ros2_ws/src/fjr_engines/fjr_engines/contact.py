# SPDX-License-Identifier: Apache-2.0
"""Contact of the arm with an obstacle: shapes of links and obstacle as geoms that collide with the other only.

The shapes are those that the pages show (fjr_monitor.scene), each mesh as its convex hull: the visuals of the URDF,
and where there are none, capsules between the joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from fjr_core.config.plant import BOX, MJCF, TABLE, UP, Obstacle
from fjr_core.errors import ParameterError
from fjr_core.model.rigid_arm import rotation_to
from fjr_core.model.robot import Robot
from fjr_core.urdf.tree import is_xml

from .mjcf.export import add_looks
from .mjcf.writing import LINK, quaternion

ARM, OBSTACLE = 1, 2
"""Bits of MuJoCo's contype of arm and obstacle; each has the other's as conaffinity."""
PREFIX = "obstacle_"


class InsideError(ParameterError):
    """An obstacle that is inside the arm."""


def add_contact(spec: mujoco.MjSpec, robot: Robot, joints: Sequence[str], obstacle: Obstacle) -> None:
    """Add an obstacle and the shapes of the links of a robot of the named joints to its specification.

    Raises ParameterError, and RobotError for a URDF that cannot be read.
    """
    add_looks(spec, robot, joints, obstacle.urdf, obstacle.locked)
    for joint in joints:
        for geom in spec.body(joint + LINK).geoms:
            geom.contype, geom.conaffinity, geom.mass = ARM, OBSTACLE, 0.0
    add_obstacle(spec, obstacle)


def add_obstacle(spec: mujoco.MjSpec, obstacle: Obstacle) -> None:
    """Add the geoms of an obstacle to a specification; raises ParameterError."""
    other = _read(obstacle.mjcf) if obstacle.kind == MJCF else mujoco.MjSpec()
    if obstacle.kind != MJCF:
        centre, turn = obstacle.position, np.eye(3)
        if obstacle.kind != BOX:
            turn = rotation_to(np.asarray(UP if obstacle.kind == TABLE else obstacle.normal))
            centre = centre - turn[:, 2] * obstacle.size[2] / 2
        place = {"pos": centre, "quat": quaternion(turn), "size": obstacle.size / 2}
        kind, brown = mujoco.mjtGeom.mjGEOM_BOX, [0.7, 0.6, 0.5, 1.0]
        other.worldbody.add_geom(name=obstacle.kind, type=kind, rgba=brown, **place)
    for geom in other.geoms:
        geom.contype, geom.conaffinity = OBSTACLE, ARM
    spec.attach(other, prefix=PREFIX, frame=spec.worldbody.add_frame())


def _read(mjcf: str) -> mujoco.MjSpec:
    """Return the bodies of an MJCF path or text, of which none may move; raise ParameterError."""
    try:
        spec = mujoco.MjSpec.from_string(mjcf) if is_xml(mjcf) else mujoco.MjSpec.from_file(mjcf)
        spec.compile()
    except ValueError as error:
        raise ParameterError(f"obstacle.mjcf: {' '.join(str(error).split())}; expected a valid MJCF") from None
    if spec.joints:
        raise ParameterError(f"obstacle.mjcf has the joint '{spec.joints[0].name}'; expected bodies that do not move")
    if not spec.geoms:
        raise ParameterError("obstacle.mjcf has no geom; expected at least one")
    return spec


def check_outside(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Raise InsideError if the arm at qpos of the data is inside the obstacle."""
    mujoco.mj_fwdPosition(model, data)
    if not data.ncon:
        return
    deepest = data.contact[int(np.argmin(data.contact.dist))]
    arm = next(geom for geom in deepest.geom if model.geom_contype[geom] == ARM)
    link = model.body(model.geom_bodyid[arm]).name.removesuffix(LINK)
    raise InsideError(
        f"the obstacle is {-1e3 * deepest.dist:.3g} mm inside the link of {link}; expected it outside the arm"
    )
