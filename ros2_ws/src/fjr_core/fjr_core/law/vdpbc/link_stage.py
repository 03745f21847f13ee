# SPDX-License-Identifier: Apache-2.0
"""Link stage, eqs. (30)-(33): the desired joint torque u_l."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from ..lie_derivative import Flow
from .symbolic_gains import GainTerms


@dataclass(frozen=True)
class LinkStage:
    """Link errors and the desired joint torque u_l, as expressions (n,)."""

    q_tilde_l: ca.SX
    s_l: ca.SX
    sigma_l: ca.SX
    u_l: ca.SX


def link_stage(flow: Flow, gains: GainTerms) -> LinkStage:
    """Return the link stage; M_l, C_l and D_l at the measured state, P_l at the virtual q_lv.

    With v_lr = M_l^-1 p_lr, the first two terms of eq. (33) are
    dp_lr + E_l v_lr = M_l dv_lr + (dM_l + E_l) v_lr = M_l dv_lr + C_l v_lr.
    The load torque (Flow.load) is subtracted.
    """
    q_lv, dq_lv = flow.virtual.q_l, flow.virtual.dq_l
    q_ld, dq_ld = flow.jets[:, 0], flow.jets[:, 1]

    q_tilde_l = q_lv - q_ld  # (30)
    v_lr = dq_ld - gains.phi_l(q_tilde_l)  # (31)
    s_l = dq_lv - v_lr  # (30)
    sigma_l = flow.M_l @ s_l

    (dv_lr,) = flow.d(v_lr)
    u_lff = flow.inertial_torque(v_lr, dv_lr) + flow.robot.links.grad_P_l(q_lv) + flow.robot.D_l @ v_lr  # (33)
    u_lfb = -gains.Pi_l @ q_tilde_l - gains.K_ld @ s_l
    return LinkStage(q_tilde_l, s_l, sigma_l, u_l=u_lff + u_lfb - flow.external)
