# SPDX-License-Identifier: Apache-2.0
"""Motor stage, eqs. (39)-(42): the effort u that tracks the desired joint torque u_l."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ...numerics.checks import Array
from ..lie_derivative import Flow
from . import integral_action
from .link_stage import LinkStage
from .symbolic_gains import GainTerms


@dataclass(frozen=True)
class MotorStage:
    """Motor errors, desired motor position and effort, as expressions (n,)."""

    q_md: ca.SX
    q_tilde_m: ca.SX
    s_m: ca.SX
    sigma_m: ca.SX
    u: ca.SX
    port: ca.SX
    """dV/dp_l (n,) [rad/s], conjugate to a torque on the links; complete only with integral action (Flow.load)."""


def motor_stage(flow: Flow, gains: GainTerms, link: LinkStage, omega: ca.SX) -> MotorStage:
    """Return the motor stage; spring at the virtual state, external input omega (n,) [N m], v_mr = M_m^-1 p_mr.

    Integral action (vdpbc.integral_action) is supported at x_v = x only.
    """
    M_m, D_m, K, B_m = flow.robot.M_m, flow.robot.D_m, flow.robot.K, flow.robot.B_m
    q_lv, q_mv, dq_mv = flow.virtual.q_l, flow.virtual.q_m, flow.virtual.dq_m

    q_md = q_lv + np.linalg.inv(K) @ link.u_l
    q_tilde_m = q_mv - q_md  # (39)
    port = integral_action.next_port(flow, link.s_l, q_md, gains.Pi_m @ q_tilde_m)
    (dq_md,) = flow.d(q_md, integral=integral_action.rate(flow, port))
    v_mr = dq_md - gains.phi_m(q_tilde_m) - coupling_velocity(gains.Pi_m_inverse, K, flow.M_l, link.s_l)  # (40)
    s_m = dq_mv - v_mr  # (39)
    sigma_m = M_m @ s_m

    port = integral_action.next_port(flow, port, v_mr, sigma_m)
    (dv_mr,) = flow.d(v_mr, integral=integral_action.rate(flow, port))
    u_mff = M_m @ dv_mr + K @ (q_mv - q_lv) + D_m @ v_mr  # (42)
    u_mfb = -gains.Pi_m @ q_tilde_m - gains.K_md @ s_m + omega
    u_mi = M_m @ integral_action.rate_correction(flow, v_mr, np.linalg.inv(K) @ gains.Pi_m @ q_tilde_m)
    return MotorStage(q_md, q_tilde_m, s_m, sigma_m, np.linalg.inv(B_m) @ (u_mff + u_mfb + u_mi), port)


def coupling_velocity(Pi_m_inverse: ca.SX, K: Array, M_l: ca.SX, s_l: ca.SX) -> ca.SX:
    """Return Pi_m^-1 K' M_l^-1 sigma_l (n,) [rad/s], the last term of eq. (40), which prints M_l' (docs/errata.md)."""
    return Pi_m_inverse @ K.T @ s_l
