# SPDX-License-Identifier: Apache-2.0
"""MuJoCo model of the elastic arm: a link and a motor joint per joint, coupled by a fixed tendon as spring."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from pinocchio import Quaternion

from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array

OFF = (
    *("constraint", "equality", "frictionloss", "limit", "contact", "refsafe", "warmstart", "filterparent"),
    *("actuation", "clampctrl", "sensor", "midphase", "autoreset", "eulerdamp"),
)


class MujocoArm:
    """MuJoCo model and data of a robot; qpos = (q_l, q_m), efforts u are qfrc_applied of the motors.

    model: Pinocchio's model of the links, revolute joints in one chain. robot: the same arm, with diagonal
    M_m, K, D_l, D_m and B_m = 1. Contacts, constraints and sensors are off; integrator RK4 with steps dt [s].
    """

    def __init__(self, model: Any, robot: Robot, dt: float) -> None:
        self.n = robot.n
        self.model = mujoco.MjModel.from_xml_string(mjcf(model, robot, dt))
        self.data = mujoco.MjData(self.model)

    def set(self, q_l: Array, q_m: Array, dq_l: Array, dq_m: Array, u: Array) -> None:
        """Set the state [rad, rad/s] and the efforts u (n,) [N m]."""
        self.data.qpos[:] = np.concatenate([q_l, q_m])
        self.data.qvel[:] = np.concatenate([dq_l, dq_m])
        self.data.qfrc_applied[self.n :] = u

    def acceleration(self) -> Array:
        """Return (ddq_l, ddq_m) (2n,) [rad/s^2] at the current state."""
        mujoco.mj_forward(self.model, self.data)
        return np.array(self.data.qacc)


def mjcf(model: Any, robot: Robot, dt: float, on: Collection[str] = ()) -> str:
    """Return the model as XML: links are nested bodies, motors are separate rotors.

    on: features that are not disabled; with "actuation" the efforts are controls.
    """
    flags = " ".join(f'{name}="disable"' for name in OFF if name not in on)
    actuators = "".join(f'<motor name="u{i}" joint="m{i}"/>' for i in range(robot.n)) if "actuation" in on else ""
    links = "".join(_link(model, i, robot) for i in range(robot.n)) + "</body>" * robot.n
    motors = "\n".join(_motor(i, robot) for i in range(robot.n))
    springs = "\n".join(_spring(i, robot) for i in range(robot.n))
    return f"""<mujoco>
  <compiler angle="radian" autolimits="false"/>
  <option integrator="RK4" timestep="{dt:.17g}" gravity="{_text(model.gravity.linear)}"><flag {flags}/></option>
  <worldbody>
    {links}
    {motors}
  </worldbody>
  <tendon>
    {springs}
  </tendon>
  <actuator>{actuators}</actuator>
</mujoco>"""


def _link(model: Any, i: int, robot: Robot) -> str:
    placement, inertia = model.jointPlacements[i + 1], model.inertias[i + 1]
    x, y, z, w = Quaternion(placement.rotation).coeffs()
    J = inertia.inertia
    tensor = [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]]
    return (
        f'<body pos="{_text(placement.translation)}" quat="{_text([w, x, y, z])}">'
        f'<inertial pos="{_text(inertia.lever)}" mass="{inertia.mass:.17g}" fullinertia="{_text(tensor)}"/>'
        f'<joint name="l{i}" axis="{_text(_axis(model, i))}" damping="{robot.D_l[i, i]:.17g}"/>'
    )


def _axis(model: Any, i: int) -> Array:
    joint = model.joints[i + 1]
    data = joint.createData()
    joint.calc(data, np.zeros(joint.nq))
    return np.asarray(data.S)[3:].ravel()


def _motor(i: int, robot: Robot) -> str:
    M_m = robot.M_m[i, i]
    return (
        f'<body name="r{i}"><inertial pos="0 0 0" mass="1" diaginertia="{_text([M_m] * 3)}"/>'
        f'<joint name="m{i}" axis="0 0 1" damping="{robot.D_m[i, i]:.17g}"/></body>'
    )


def _spring(i: int, robot: Robot) -> str:
    ends = f'<joint joint="l{i}" coef="-1"/><joint joint="m{i}" coef="1"/>'
    return f'<fixed name="k{i}" stiffness="{robot.K[i, i]:.17g}" springlength="0">{ends}</fixed>'


def _text(numbers: ArrayLike) -> str:
    return " ".join(f"{number:.17g}" for number in np.asarray(numbers).ravel())
