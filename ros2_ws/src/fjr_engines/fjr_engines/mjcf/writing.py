# SPDX-License-Identifier: Apache-2.0
"""Specify a flexible-joint robot for MuJoCo: eq. (36) by elements of the engine.

A link is a body on the hinge (or slide) of its joint. A rotor is a body on the base with a hinge of its own, so that it
has the kinetic energy M_m dq_m^2 / 2 of eq. (35) alone: M_m is the `armature` of its hinge. The spring between both is
a fixed tendon of the length q_m - q_l. Damping acts at the hinges.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import RobotError
from fjr_core.model.rigid_arm import Body
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import MOTOR, Array
from fjr_plant.engine import chain, gravity_and_chain

LINK, SPRING = "_link", "_spring"
"""Endings of the names of links and springs after that of the joint; rotors have MOTOR, as in the states."""
LEAST = 1e-12
"""Least mass [kg] and inertia [kg m^2] of a body that moves; MuJoCo compiles none below 1e-15."""


def specification(robot: Robot, joints: Sequence[str]) -> mujoco.MjSpec:
    """Return the MuJoCo model of a robot of the n named joints; raise RobotError for one that it cannot express.

    The integrator is MuJoCo's Runge-Kutta of order 4. Contacts, limits and actuators are added by the caller. Of
    matrices that couple joints, K, D_l and D_m have their diagonals only.
    """
    (gravity, bodies), spec = gravity_and_chain(robot, "MuJoCo"), mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.gravity = gravity
    spec.compiler.autolimits = True
    parent = spec.worldbody
    for k, body in bodies:
        place = {"pos": np.asarray(body.translation), "quat": quaternion(np.asarray(body.rotation))}
        parent = parent.add_body(name=joints[k] + LINK, **place)
        _add_inertia(parent, body)
        _add_joint(parent, joints[k], body.prismatic, damping=robot.D_l[k, k])
    for k, body in sorted(bodies):
        joint, rotor = joints[k], spec.worldbody.add_body(name=joints[k] + MOTOR)
        rotor.mass, rotor.inertia, rotor.explicitinertial = LEAST, [LEAST] * 3, True
        _add_joint(rotor, joint + MOTOR, body.prismatic, damping=robot.D_m[k, k]).armature = robot.M_m[k, k]
        spring = spec.add_tendon(name=joint + SPRING)
        spring.stiffness, spring.springlength = linear(robot.K[k, k]), [0.0, 0.0]
        spring.wrap_joint(joint + MOTOR, 1.0)
        spring.wrap_joint(joint, -1.0)
    return spec


def exact_inertia(model: mujoco.MjModel, robot: Robot, joints: Sequence[str]) -> None:
    """Give the links of a compiled model the moments of inertia of the robot, also those that MuJoCo does not compile.

    It compiles moments that are positive and the sides of a triangle; those of public URDFs often are not. Rotors have
    their armature alone.
    """
    for k, body in chain(robot):
        model.body(joints[k] + MOTOR).inertia = np.zeros(3)
        model.body(joints[k] + LINK).inertia = np.linalg.eigvalsh(np.asarray(body.inertia))
    mujoco.mj_setConst(model, mujoco.MjData(model))


@contextmanager
def refusals(expected: str) -> Iterator[None]:
    """Raise RobotError with what MuJoCo says, where it refuses a model, and what was expected."""
    try:
        yield
    except (ValueError, mujoco.FatalError) as error:
        raise RobotError(f"MuJoCo says: {' '.join(str(error).split())}; expected {expected}") from None


def quaternion(rotation: Array) -> Array:
    """Return the unit quaternion (4,) of a rotation (3, 3), scalar first."""
    found = np.empty(4)
    mujoco.mju_mat2Quat(found, np.ascontiguousarray(rotation, dtype=float).ravel())
    return found


def pose_of(position: ArrayLike, rotation: ArrayLike) -> Array:
    """Return the pose (4, 4) of a frame at a position (3,) with the nine entries of a rotation."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.reshape(rotation, (3, 3)), position
    return pose


def linear(coefficient: float) -> list[float]:
    """Return the coefficients of MuJoCo's polynomial of a spring or a damper that is linear."""
    return [coefficient, 0.0, 0.0]


def _add_inertia(link: mujoco.MjsBody, body: Body) -> None:
    """Give a link its mass, and the nearest inertia that a rigid body can have."""
    moments, axes = np.linalg.eigh(np.asarray(body.inertia))
    axes[:, 2] *= np.linalg.det(axes)
    smallest = max(moments[0], moments[2] - moments[1], LEAST)
    link.mass, link.ipos, link.explicitinertial = max(body.mass, LEAST), np.asarray(body.com), True
    link.inertia, link.iquat = np.maximum(moments, [smallest, LEAST, LEAST]), quaternion(axes)


def _add_joint(owner: mujoco.MjsBody, name: str, slides: bool, damping: float) -> mujoco.MjsJoint:
    kinds = mujoco.mjtJoint
    kind = kinds.mjJNT_SLIDE if slides else kinds.mjJNT_HINGE
    return owner.add_joint(name=name, type=kind, axis=[0.0, 0.0, 1.0], damping=linear(damping))
