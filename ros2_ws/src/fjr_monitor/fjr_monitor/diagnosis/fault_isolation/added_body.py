# SPDX-License-Identifier: Apache-2.0
"""Compute the joint torques of a body fixed to one link, linear in its ten inertial parameters."""

from __future__ import annotations

import casadi as ca
import numpy as np

from fjr_core.errors import RobotError
from fjr_core.model.rigid_arm import ArmDynamics
from fjr_core.numerics.checks import Array

from .torque_residuals import over_rows

SECOND_MOMENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
PARAMETERS = 4 + len(SECOND_MOMENTS)


def body_torques(links: ArmDynamics, link: int, q_l: Array, dq_l: Array, ddq_l: Array) -> Array:
    """Return the torques (k, n, 10) per inertial parameter of a body fixed to `link`, at k states (k, n).

    Parameters: m [kg]; m r [kg m] (3); sum m r r' [kg m^2] (6, in the order of SECOND_MOMENTS), r in the frame of
    the last link with the joints after `link` held at 0. d/dt dL/d(dq_l) - dL/dq_l with the Lagrangian
    L = sum m (|dp|^2 / 2 + g'p), p = p_0 + R r. Raises RobotError for links without an end-effector frame.
    """
    function, n = _function(links, link), links.n
    return over_rows(lambda rows: function(rows).full(), np.hstack([q_l, dq_l, ddq_l]), PARAMETERS).reshape(-1, n, 10)


def _function(links: ArmDynamics, link: int) -> ca.Function:
    """Build the function (q_l, dq_l, ddq_l) stacked -> (n, 10)."""
    if links.end_effector is None:
        raise RobotError("the links have no end-effector frame; expected links with one")
    n = links.n
    state, theta = ca.SX.sym("state", 3 * n), ca.SX.sym("theta", PARAMETERS)
    q_l, dq_l, ddq_l = ca.vertsplit(state, n)
    held = ca.vertcat(q_l[: link + 1], ca.SX.zeros(n - link - 1))
    p_0 = links.end_effector.position(held, ca.SX.zeros(3))
    R = ca.horzcat(*(links.end_effector.position(held, ca.SX.eye(3)[:, i]) - p_0 for i in range(3)))
    dp_0, dR = ca.jtimes(p_0, q_l, dq_l), ca.reshape(ca.jtimes(ca.vec(R), q_l, dq_l), 3, 3)
    m, mr, moments = theta[0], theta[1:4], theta[4:]
    S = ca.SX(3, 3)
    for value, (i, j) in zip(ca.vertsplit(moments), SECOND_MOMENTS, strict=True):
        S[i, j] = S[j, i] = value
    kinetic = m * ca.dot(dp_0, dp_0) / 2 + ca.dot(dp_0, dR @ mr) + ca.trace(dR @ S @ dR.T) / 2
    L = kinetic + ca.dot(ca.DM(links.end_effector.gravity), m * p_0 + R @ mr)
    momentum = ca.gradient(L, dq_l)
    rate = ca.jtimes(momentum, ca.vertcat(q_l, dq_l), ca.vertcat(dq_l, ddq_l))
    torque = rate - ca.gradient(L, q_l)
    return ca.Function("body_torques", [state], [ca.densify(ca.jacobian(torque, theta))], {"cse": True})
