# SPDX-License-Identifier: Apache-2.0
"""The elastic arm of fjr_engines in MuJoCo alone, as a peer: with all features off that eq. (36) does not need."""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np

from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_engines.mjcf.writing import MOTOR, specification

OFF = (
    *("CONSTRAINT", "EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT", "REFSAFE", "WARMSTART", "FILTERPARENT"),
    *("ACTUATION", "CLAMPCTRL", "SENSOR", "MIDPHASE", "AUTORESET", "EULERDAMP"),
)
JOINT = "joint{}"


def peer(robot: Robot, dt: float, on: Collection[str] = ()) -> mujoco.MjSpec:
    """Return the model of a robot with steps of dt [s] with motors as controls; on: features that are not disabled."""
    joints = [JOINT.format(k) for k in range(robot.n)]
    spec = specification(robot, joints)
    spec.option.timestep = dt
    spec.option.disableflags = sum(
        int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")) for name in OFF if name not in on
    )
    for joint in joints if "ACTUATION" in on else ():
        spec.add_actuator(name=joint, target=joint + MOTOR, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    return spec


class MujocoArm:
    """MuJoCo's model and data of a robot; qpos = (q_l, q_m), efforts u are qfrc_applied of the motors."""

    def __init__(self, robot: Robot, dt: float) -> None:
        self.n = robot.n
        self.model = peer(robot, dt).compile()
        self.data = mujoco.MjData(self.model)

    def set(self, q_l: Array, q_m: Array, dq_l: Array, dq_m: Array, u: Array) -> None:
        """Set the state [rad, rad/s] and the efforts u (n,) [N m]."""
        self.data.qpos[:] = np.concatenate([q_l, q_m])
        self.data.qvel[:] = np.concatenate([dq_l, dq_m])
        self.data.qfrc_applied[self.n :] = u
