# SPDX-License-Identifier: Apache-2.0
"""The motor stage, eqs. (39)-(42): the effort u that makes the springs give u_l."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from .. import symbolic
from ..checks import Array
from ..flow import Flow
from ..gains import CheckedGains
from .link import LinkStage


@dataclass(frozen=True)
class MotorStage:
    """Errors of the motors, their wanted position and the effort, as expressions (n,)."""

    q_md: ca.SX
    q_tilde_m: ca.SX
    sigma_m: ca.SX
    s_m: ca.SX
    u: ca.SX


def motor_stage(flow: Flow, gains: CheckedGains, link: LinkStage, omega: ca.SX) -> MotorStage:
    """The motor stage of the law at (x_v, x, jets); the spring at the virtual state; omega (n,) external input."""
    robot, n = flow.robot, flow.robot.n
    q_l = symbolic.blocks(flow.x, n)[0]
    q_lv, q_mv, _, p_mv = symbolic.blocks(flow.x_v, n)
    M_l, M_m, K = robot.links.M_l(q_l), robot.M_m, robot.K

    q_md = q_lv + np.linalg.inv(K) @ link.u_l
    (dq_md,) = flow.d(q_md)
    q_tilde_m = q_mv - q_md  # (39)
    v_mr = dq_md - gains.phi_m(q_tilde_m) - coupling_velocity(gains.Pi_m, K, M_l, link.sigma_l)  # (40)
    p_mr = M_m @ v_mr
    sigma_m = p_mv - p_mr  # (39)
    s_m = np.linalg.inv(M_m) @ sigma_m

    (dp_mr,) = flow.d(p_mr)
    u_mff = dp_mr + K @ (q_mv - q_lv) + robot.D_m @ v_mr  # (42)
    u_mfb = -gains.Pi_m @ q_tilde_m - gains.K_md @ s_m + omega
    return MotorStage(q_md, q_tilde_m, sigma_m, s_m, u=np.linalg.inv(robot.B_m) @ (u_mff + u_mfb))


def coupling_velocity(Pi_m: Array, K: Array, M_l: ca.SX, sigma_l: ca.SX) -> ca.SX:
    """Pi_m^-1 K' M_l^-1 sigma_l (n,), the last term of eq. (40), which prints M_l' (docs/errata.md)."""
    return np.linalg.inv(Pi_m) @ K.T @ symbolic.solve(M_l, sigma_l)
