# SPDX-License-Identifier: Apache-2.0
"""Integral action against a torque d on the links, with the storage V + integral' gain^-1 integral / 2.

A torque beside the model, d - w - integral, enters dV/dt through the port dV/dp_l alone. The integral moves by
gain times that port, so that it takes up what the port supplies: with w the known part (docs/robust.md)

    d/dt (V + integral' gain^-1 integral / 2) = -dissipation + (dV/dp_l)' (d - w) + s_m' omega        exactly.

dV/dp_l = s_l - (dq_md/dp_l)' Pi_m qt_m - (dv_mr/dp_l)' sigma_m grows stage by stage, as the tuning functions of
adaptive backstepping do (Krstic, Kanellakopoulos, Kokotovic 1992): each stage counts on the rate found so far, and
`lag` makes up for the part that the stage of q_md could not know. Without an integral (Flow.load) nothing is added.
"""

from __future__ import annotations

import casadi as ca

from ..lie_derivative import Flow


def port_less(flow: Flow, port: ca.SX, wanted: ca.SX, force: ca.SX) -> ca.SX:
    """The port (n,) [rad/s] with a stage more: port - (d wanted/dp_l)' force."""
    return port if flow.integrated is None else port - flow.slope(wanted, force)


def rate(flow: Flow, port: ca.SX) -> ca.SX | None:
    """The rate (n,) [N m/s] of the load's integral that a port gives; None without one."""
    return None if flow.integrated is None else flow.integrated.gain @ port


def lag(flow: Flow, v_mr: ca.SX, force: ca.SX) -> ca.SX:
    """Acceleration (n,) that makes up for what dq_md lacks: (dv_mr/dp_l) gain force, force = K^-1 Pi_m qt_m."""
    load = flow.integrated
    return ca.SX(flow.robot.n, 1) if load is None else flow.pushed(v_mr, load.gain @ force)
