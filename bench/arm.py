# SPDX-License-Identifier: Apache-2.0
"""The seven-joint arm of the scenario `arm7`, also as Pinocchio's model, and elastic robots as models of MuJoCo."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from typing import Any

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin

from fjr_core.config.scenario import Scenario
from fjr_core.model.rigid_arm import ArmDynamics
from fjr_core.model.robot import Robot
from fjr_core.numerics import symbolic
from fjr_core.numerics.checks import Array
from fjr_engines.mjcf.writing import MOTOR, specification
from fjr_msgs_py.scenarios import library

URDF = library.find("arm7").parents[1] / "robots" / "arm7.urdf"
JOINT = "joint{}"
NEEDED = ("SPRING", "DAMPER", "GRAVITY")
"""Features of MuJoCo that eq. (36) needs, among those that can be disabled."""


@cache
def arm7() -> Scenario:
    """Return the scenario `arm7`, whose law and plant are compiled."""
    return library.load("arm7")


@cache
def rigid_arm7() -> Any:
    """Return Pinocchio's model of `arm7`; its joints are those of its URDF, in the same order."""
    return pin.buildModelFromUrdf(str(URDF))


def forward_dynamics(links: ArmDynamics) -> ca.Function:
    """Return the rigid forward dynamics (q, dq, tau) -> ddq = M^-1 (tau - C dq - grad P)."""
    q, dq, tau = (ca.SX.sym(name, links.n) for name in ("q", "dq", "tau"))
    ddq = symbolic.solve(links.M_l(q), tau - links.C(q, dq, dq) - links.grad_P_l(q))
    return ca.Function("forward_dynamics", [q, dq, tau], [ca.densify(ddq)], {"cse": True})


def random_motion(n: int, seed: int) -> tuple[Array, Array, Array]:
    """Return random positions [rad], velocities [rad/s] and torques [N m], each (n,)."""
    random = np.random.default_rng(seed)
    return random.uniform(-1.5, 1.5, n), random.uniform(-1.0, 1.0, n), random.uniform(-20.0, 20.0, n)


def mujoco_spec(robot: Robot, dt: float, on: Collection[str] = ()) -> mujoco.MjSpec:
    """Return the elastic robot of fjr_engines in MuJoCo alone, with steps of dt [s]; qpos = (q_l, q_m).

    on: other features that are not disabled; with "ACTUATION" the motors are controls, else efforts are qfrc_applied.
    """
    joints = [JOINT.format(k) for k in range(robot.n)]
    spec = specification(robot, joints)
    spec.option.timestep = dt
    needed, bits = {f"mjDSBL_{name}" for name in (*NEEDED, *on)}, mujoco.mjtDisableBit.__members__
    spec.option.disableflags = sum(int(bits[name]) for name in {*bits} - needed if name.startswith("mjDSBL_"))
    for joint in joints if "ACTUATION" in on else ():
        spec.add_actuator(name=joint, target=joint + MOTOR, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    return spec
