# SPDX-License-Identifier: Apache-2.0
"""The link stage of Brogliato, Ortega, Lozano 1995: Slotine's and Li's law gives the torque that the springs should."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca

from ..lie_derivative import Flow


@dataclass(frozen=True)
class LinkStage:
    """e = q - q_d, de, s = de + Lambda e, and the wanted spring torque tau_d; expressions (n,).

    With theta_d so that the springs give tau_d at the error zero of the motors, M_l ds + (C_l + D_l + K_1) s = what
    the springs give beyond tau_d.
    """

    e: ca.SX
    de: ca.SX
    s: ca.SX
    tau_d: ca.SX


def link_stage(f: Flow, g: SimpleNamespace) -> LinkStage:
    """tau_d = M_l ddq_r + C_l dq_r + D_l dq_r + grad P_l - K_1 s,  dq_r = dq_d - Lambda e; Lambda (1,), K_1 (n, n)."""
    links, m = f.robot.links, f.measured
    e, de = m.q_l - f.jets[:, 0], m.dq_l - f.jets[:, 1]
    dq_r = f.jets[:, 1] - g.Lambda * e
    ddq_r = f.jets[:, 2] - g.Lambda * de
    s = m.dq_l - dq_r
    tau_d = f.M_l @ ddq_r + links.C(m.q_l, m.dq_l, dq_r) + f.robot.D_l @ dq_r + links.grad_P_l(m.q_l) - g.K_1 @ s
    return LinkStage(e, de, s, tau_d)
