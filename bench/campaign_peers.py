# SPDX-License-Identifier: Apache-2.0
"""One run of the paper's joint in typical SciPy and MuJoCo code; both call the compiled law."""

from __future__ import annotations

from collections.abc import Callable
from math import sin
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from bench.mujoco_arm import MujocoArm
from fjr_core import TrackingLaw, single_link
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.simulation.batch import ClosedLoop, Draws

NAMES = ("stiffness", "link_inertia", "gravity", "motor_inertia", "link_damping", "motor_damping")
GRAVITY = 9.81  # m/s^2
MASS = 1.0  # kg, of MuJoCo's link; its gravity torque and inertia are those of the joint

Peer = Callable[[ClosedLoop, Draws, int], float]
"""(loop, draws, run) -> RMS error of the link from loop.settle_after on [rad]."""


def scipy_peer(loop: ClosedLoop, draws: Draws, run: int) -> float:
    """Simulate a run by solve_ivp with default method and tolerances over each sample."""
    M_l, load, M_m, K, D_l, D_m = numbers(loop.robot, draws, run)
    period = loop.sample_period

    def follow(x: Array, u: float) -> Array:
        def derivative(_t: float, x: Array) -> tuple[float, float, float, float]:
            q_l, q_m, dq_l, dq_m = x
            spring = K * (q_m - q_l)
            return dq_l, dq_m, (spring - D_l * dq_l - load * sin(q_l)) / M_l, (u - spring - D_m * dq_m) / M_m

        return np.asarray(solve_ivp(derivative, (0.0, period), x).y[:, -1])

    return _tracked(loop, follow)


def mujoco_peer(loop: ClosedLoop, draws: Draws, run: int) -> float:
    """Simulate a run by mj_step, all steps of a sample in one call."""
    peer = mujoco_joint(loop.robot, draws, run, loop.sample_period / loop.inner_steps)
    model, data, first = peer.model, peer.data, [True]

    def follow(x: Array, u: float) -> Array:
        if first:
            data.qpos[:], data.qvel[:] = x[:2], x[2:]
            first.clear()
        data.qfrc_applied[1] = u
        mujoco.mj_step(model, data, nstep=loop.inner_steps)
        x[:2], x[2:] = data.qpos, data.qvel
        return x

    return _tracked(loop, follow)


def mujoco_joint(robot: Robot, draws: Draws, run: int, dt: float) -> MujocoArm:
    """Return the joint with the drawn parameters as a MuJoCo model."""
    M_l, load, M_m, K, D_l, D_m = numbers(robot, draws, run)
    return MujocoArm(pendulum(M_l, load), single_link(K, M_l, load, M_m, D_l, D_m), dt)


def pendulum(M_l: float, load: float) -> Any:
    """Return Pinocchio's model of a link with the inertia M_l [kg m^2] and the gravity torque load sin q [N m]."""
    lever = load / (MASS * GRAVITY)
    about_com = M_l - MASS * lever**2
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint")
    inertia = pin.Inertia(MASS, np.array([0.0, 0.0, -lever]), about_com * np.eye(3))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    return model


def numbers(robot: Robot, draws: Draws, run: int) -> tuple[float, float, float, float, float, float]:
    """Return M_l, m g l, M_m, K, D_l and D_m of a run."""
    factor = {name: float(np.asarray(getattr(draws, name))[run]) for name in NAMES}
    load = float(robot.grad_P_l([np.pi / 2])[0]) * factor["gravity"]
    M_l, M_m = float(robot.M_l([0.0])[0, 0]), float(robot.M_m[0, 0])
    return (
        M_l * factor["link_inertia"],
        load,
        M_m * factor["motor_inertia"],
        float(robot.K[0, 0]) * factor["stiffness"],
        float(robot.D_l[0, 0]) * factor["link_damping"],
        float(robot.D_m[0, 0]) * factor["motor_damping"],
    )


def _tracked(loop: ClosedLoop, follow: Callable[[Array, float], Array]) -> float:
    """Run the loop; follow: (q_l, q_m, dq_l, dq_m) and held effort -> state one sample later."""
    assert isinstance(loop.law, TrackingLaw)
    samples = round(loop.duration / loop.sample_period)
    table = loop.reference.jets(loop.sample_period * np.arange(samples + 1))
    q = np.asarray(loop.x0)[:2]
    x = np.concatenate([q, *loop.robot.velocities(loop.x0)])
    error = np.empty(samples + 1)
    for k in range(samples + 1):
        error[k] = x[0] - table[k, 0, 0]
        if k < samples:
            x = follow(x, loop.law.measured_command(x[:2], x[2:], table[k])[0][0])
    after = error[round(loop.settle_after / loop.sample_period) :]
    return float(np.sqrt(np.mean(after**2)))
