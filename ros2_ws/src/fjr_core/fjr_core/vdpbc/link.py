# SPDX-License-Identifier: Apache-2.0
"""The link stage, eqs. (30)-(33): the torque u_l that the springs would have to give."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from .. import symbolic
from ..flow import Flow
from ..gains import CheckedGains


@dataclass(frozen=True)
class LinkStage:
    """Errors of the links and the wanted spring torque, as expressions (n,)."""

    q_tilde_l: ca.SX
    sigma_l: ca.SX
    s_l: ca.SX
    u_l: ca.SX


def link_stage(flow: Flow, gains: CheckedGains) -> LinkStage:
    """The link stage of the law at (x_v, x, jets); M_l, E_l, D_l at the measured x, P_l at the virtual q_lv."""
    robot, links, n = flow.robot, flow.robot.links, flow.robot.n
    q_l = symbolic.blocks(flow.x, n)[0]
    q_lv, _, p_lv, _ = symbolic.blocks(flow.x_v, n)
    q_ld, dq_ld = flow.jets[:, 0], flow.jets[:, 1]
    dq_l = robot.velocity_expressions(flow.x)[0]
    M_l = links.M_l(q_l)

    q_tilde_l = q_lv - q_ld  # (30)
    v_lr = dq_ld - gains.phi_l(q_tilde_l)  # (31)
    p_lr = M_l @ v_lr
    sigma_l = p_lv - p_lr  # (30)
    s_l = symbolic.solve(M_l, sigma_l)

    (dp_lr,) = flow.d(p_lr)
    u_lff = dp_lr + links.grad_P_l(q_lv) + links.E(q_l, dq_l, v_lr) + robot.D_l @ v_lr  # (33)
    u_lfb = -gains.Pi_l @ q_tilde_l - gains.K_ld @ s_l
    return LinkStage(q_tilde_l, sigma_l, s_l, u_l=u_lff + u_lfb)
