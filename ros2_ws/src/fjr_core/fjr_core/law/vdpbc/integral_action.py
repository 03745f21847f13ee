# SPDX-License-Identifier: Apache-2.0
"""Integral action against a disturbance torque d on the links, with the storage V + integral' gain^-1 integral / 2.

The uncompensated torque d - w - integral, with w the known part, enters dV/dt only through the port output dV/dp_l.
The integral is driven by gain times this output (docs/robust.md), so that

    d/dt (V + integral' gain^-1 integral / 2) = -dissipation + (dV/dp_l)' (d - w) + s_m' omega

holds exactly. dV/dp_l = s_l - (dq_md/dp_l)' Pi_m qt_m - (dv_mr/dp_l)' sigma_m is built stage by stage, as the tuning
functions of adaptive backstepping are (Krstic, Kanellakopoulos, Kokotovic 1992). Each stage uses the integral's rate
known so far; `rate_correction` adds the part that was unknown at the stage of q_md. Without integral action (Flow.load)
all functions return their neutral value.
"""

from __future__ import annotations

import casadi as ca

from ..lie_derivative import Flow


def next_port(flow: Flow, port: ca.SX, desired: ca.SX, force: ca.SX) -> ca.SX:
    """Return the port output (n,) [rad/s] extended by one stage: port - (d desired/dp_l)' force."""
    return port if flow.integrated is None else port - flow.momentum_vjp(desired, force)


def rate(flow: Flow, port: ca.SX) -> ca.SX | None:
    """Return the rate (n,) [N m/s] of the load's integral for a port output; None without integral action."""
    return None if flow.integrated is None else flow.integrated.gain @ port


def rate_correction(flow: Flow, v_mr: ca.SX, force: ca.SX) -> ca.SX:
    """Return the acceleration (n,) that completes dq_md: (dv_mr/dp_l) gain force, force = K^-1 Pi_m qt_m."""
    load = flow.integrated
    return ca.SX(flow.robot.n, 1) if load is None else flow.momentum_jvp(v_mr, load.gain @ force)
