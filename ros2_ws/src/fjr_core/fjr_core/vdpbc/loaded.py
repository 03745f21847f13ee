# SPDX-License-Identifier: Apache-2.0
"""The law with torques that it knows of beside its model, and integral action against those that it does not."""

from __future__ import annotations

import casadi as ca

from ..flow import Load, flow
from ..numeric import dense_function
from .law import TrackingLaw

OUTPUTS = ("u", "V", "dissipation", "port_l", "port_m")


def loaded_expression(law: TrackingLaw) -> ca.Function:
    """The CasADi function of the law u(x, x, t) with a load, never machine code.

    (position (2n,), velocity (2n,), jets (n, 5), gains (g,), known (n, 3), integral (n,), integral_gain (n, n),
    matched (n,)) -> OUTPUTS. known: torque on the links with two rates; integral (n,) [N m]: the state of the
    integral action, with integral_gain [N m/rad], symmetric (Load); matched (n,) [N m]: torque on the motors; both
    are what the law counts on. V [J] without the energy of the integral. dissipation [W]: see
    vdpbc.integral. port_l = dV/dp_l, port_m = s_m = dV/dp_m (n,) [rad/s].
    """
    n = law.robot.n
    load, matched = Load.named(n), ca.SX.sym("matched", n)
    f = flow(law.robot, diagonal=True, load=load)
    inputs, outputs = law.measured_expressions(f, -matched)
    arguments = inputs | {
        "known": load.known,
        "integral": load.integral,
        "integral_gain": load.gain,
        "matched": matched,
    }
    found = outputs | {"port_m": outputs["s_m"]}
    return dense_function("loaded_command", arguments, {name: found[name] for name in OUTPUTS}, cse=True)
