# SPDX-License-Identifier: Apache-2.0
"""Compute the inverse dynamics of a flexible-joint robot: motor motion and torque for a given link motion.

The link positions are a flat output (De Luca, 2000, "Feedforward/feedback laws for the control of flexible robots",
ICRA; Spong 1987). The motor motion follows from q .. d4q without integration:

    tau   = M_l ddq + C_l dq + D_l dq + grad P_l         joint (spring) torque
    theta = q + K^-1 tau                                 motor positions; phi^-1(tau) of springs that harden
    u     = B_m^-1 (M_m ddtheta + D_m dtheta + tau)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..model import springs
from ..model.robot import Robot
from ..numerics.checks import Array
from .spline import SampledMotion

SUBDIVISIONS = 4, 4096
"""Instants per piece of the motion, and instants in all, at least."""
EVENLY, LARGEST = 1024, 64
"""Instants at which efforts are evaluated: spread evenly, and those of the largest derivatives of each joint."""


@dataclass(frozen=True)
class MotorMotion:
    """Joint torque tau (n,) [N m], motor motion theta, dtheta, ddtheta (n,), and motor torque B_m u (n,) [N m]."""

    tau: ca.SX
    theta: ca.SX
    dtheta: ca.SX
    ddtheta: ca.SX
    torque: ca.SX


def spring_torque(robot: Robot, q: ca.SX, dq: ca.SX, ddq: ca.SX) -> ca.SX:
    """Return the joint torque tau (n,) [N m] for a link motion: inverse dynamics of the rigid arm."""
    return robot.links.inertial_torque(q, dq, dq, ddq) + robot.D_l @ dq + robot.links.grad_P_l(q)


def motor_motion(robot: Robot, *motion: ca.SX) -> MotorMotion:
    """Return the motor motion for the link motion q, dq, ddq, d3q, d4q, each (n,)."""
    return MotorMotion(*inverse_dynamics(robot)(*motion))


@lru_cache(maxsize=8)
def inverse_dynamics(robot: Robot) -> ca.Function:
    """Return the CasADi function (q, dq, ddq, d3q, d4q) -> the fields of MotorMotion."""
    q, dq, ddq, d3q, d4q = motion = [ca.SX.sym(name, robot.n) for name in ("q", "dq", "ddq", "d3q", "d4q")]
    tau = spring_torque(robot, q, dq, ddq)
    dtau = ca.jtimes(tau, ca.vertcat(q, dq, ddq), ca.vertcat(dq, ddq, d3q))
    ddtau = ca.jtimes(dtau, ca.vertcat(q, dq, ddq, d3q), ca.vertcat(dq, ddq, d3q, d4q))
    t, dt, ddt = torques = [ca.SX.sym(name, robot.n) for name in ("tau", "dtau", "ddtau")]
    zeta = springs.deflection(robot, t)
    dzeta = ca.jtimes(zeta, t, dt)
    ddzeta = ca.jtimes(dzeta, ca.vertcat(t, dt), ca.vertcat(dt, ddt))
    deflections = ca.substitute([zeta, dzeta, ddzeta], torques, [tau, dtau, ddtau])
    theta, dtheta, ddtheta = (a + b for a, b in zip((q, dq, ddq), deflections, strict=True))
    torque = robot.M_m @ ddtheta + robot.D_m @ dtheta + tau
    return ca.Function("motor_motion", motion, [tau, theta, dtheta, ddtheta, torque])


class EffortDemand(NamedTuple):
    """Largest |u| (n,) [N m] along a motion, and the times (n,) [s] at which it is needed."""

    peak: Array
    at: Array


def effort_demand(robot: Robot, motion: SampledMotion, t0: float = 0.0, t1: float = np.inf) -> EffortDemand:
    """Return the largest efforts along a motion from t0 to t1 [s].

    u = B_m^-1 (M_m ddtheta + D_m dtheta + tau), by the inverse dynamics of the flexible-joint robot.
    """
    knots = motion.knot_times
    times = knots[np.searchsorted(knots, t0, side="right") - 1 : np.searchsorted(knots, t1) + 1]
    parts = max(SUBDIVISIONS[0], -(-SUBDIVISIONS[1] // len(times)))
    inner = times[:-1, None] + np.diff(times)[:, None] * np.arange(parts) / parts
    instants = np.append(inner.ravel(), np.nextafter(times[-1], -np.inf))
    jets = motion.jets(instants)
    chosen = _chosen(jets)
    jets, instants = jets[chosen], instants[chosen]
    motor_torque = inverse_dynamics(robot).map(len(instants))(*(row.T for row in jets.swapaxes(0, 1)))[-1].full()
    effort = np.abs(np.linalg.solve(robot.B_m, motor_torque))
    effort[np.isnan(effort)] = np.inf
    largest = effort.argmax(axis=1)
    return EffortDemand(effort[np.arange(robot.n), largest], instants[largest])


def _chosen(jets: Array) -> NDArray[np.intp]:
    """Return the indices of the instants at which to evaluate the efforts of jets (k, 5, n).

    Efforts vary slowly with position, velocity and acceleration, and peak with the derivatives that peak.
    """
    k = len(jets)
    derivatives = np.abs(jets[:, 2:]).reshape(k, -1)
    peaks = np.argpartition(derivatives, -min(LARGEST, k), axis=0)[-min(LARGEST, k) :]
    return np.unique(np.concatenate([np.linspace(0, k - 1, min(EVENLY, k)).astype(int), peaks.ravel()]))
