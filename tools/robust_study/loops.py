# SPDX-License-Identifier: Apache-2.0
"""Robots that differ from the model of their law, and sampled loops with disturbance compensation on them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

import fjr_core as fjr
from fjr_core.numerics.checks import Array
from fjr_core.robust.law import Robust, sampled_law

PERIOD = 1e-3  # s


def pushed(robot: fjr.Robot, torque: Any) -> fjr.Robot:
    """Return the robot with a constant torque (n,) [N m] on its links: P_l - torque' q_l."""
    links, q = robot.links, ca.SX.sym("q", robot.n)
    d = ca.DM(np.broadcast_to(np.asarray(torque, dtype=float), robot.n))
    P_l = ca.Function("P_l", [q], [links.P_l(q) - ca.dot(d, q)])
    grad_P_l = ca.Function("grad_P_l", [q], [links.grad_P_l(q) - d])
    return replace(robot, links=replace(links, P_l=P_l, grad_P_l=grad_P_l))


def heavier(robot: fjr.Robot, factor: float, gravity: float = 1.0) -> fjr.Robot:
    """Return the robot with scaled link inertia (factor) and gravity torque (gravity)."""
    links, n = robot.links, robot.n
    q, v, w, a = (ca.SX.sym(name, n) for name in ("q", "v", "w", "a"))
    inertial = factor * links.inertial_torque(q, v, w, a)
    return replace(
        robot,
        links=replace(
            links,
            M_l=ca.Function("M_l", [q], [factor * links.M_l(q)]),
            C=ca.Function("C", [q, v, w], [factor * links.C(q, v, w)]),
            inertial_torque=ca.Function("inertial_torque", [q, v, w, a], [inertial]),
            grad_T=ca.Function("grad_T", [q, v], [factor * links.grad_T(q, v)]),
            P_l=ca.Function("P_l", [q], [gravity * links.P_l(q)]),
            grad_P_l=ca.Function("grad_P_l", [q], [gravity * links.grad_P_l(q)]),
            M_l_vertices=None,
        ),
    )


def errors(
    law: fjr.TrackingLaw,
    robust: Robust | None,
    reference: fjr.Reference,
    robot: fjr.Robot,
    seconds: float,
    delay: float = 0.0,
    position: Any = None,
) -> Array:
    """Return q_l - q_ld (k, n) [rad] of a 1 kHz loop, starting on the reference or at rest at `position` [rad].

    delay [s]: of the command; the plant takes 4 steps per sample.
    """
    n, jets = robot.n, reference.jets(0.0)
    q_l = jets[0] if position is None else np.broadcast_to(np.asarray(position, dtype=float), n)
    dq_l = jets[1] if position is None else np.zeros(n)
    x0 = robot.state(q_l, q_l + np.linalg.solve(robot.K, robot.grad_P_l(q_l)), dq_l, dq_l)
    run = fjr.simulate(fjr.Plant(robot), sampled_law(law, robust), reference, x0, seconds, PERIOD, delay=delay)
    return np.asarray(run.x[:, :n] - run.jets[:, 0])


def rms(e: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(e**2)))
