# SPDX-License-Identifier: Apache-2.0
"""The law with torques that it knows of beside its model, and integral action against those that it does not."""

from __future__ import annotations

import casadi as ca

from ...numerics.casadi_function import dense_function
from ..lie_derivative import Load, flow
from ..vdpbc.law import TrackingLaw

OUTPUTS = ("u", "V", "dissipation", "port_m", "port_l")


def loaded_expression(law: TrackingLaw, integrates: bool = True) -> ca.Function:
    """The CasADi function of the law u(x, x, t) with a load, never machine code.

    (position (2n,), velocity (2n,), jets (n, 5), gains (g,), known (n, 3), matched (n,), integral (n,),
    integral_gain (n, n)) -> OUTPUTS. known: torque on the links with two rates; matched (n,) [N m]: torque on the
    motors; both are what the law counts on. integral (n,) [N m]: the state of the integral action, with
    integral_gain [N m/rad], symmetric (flow.Load). V [J] without the energy of the integral. dissipation [W]: see
    vdpbc.integral. port_m = s_m = dV/dp_m, port_l = dV/dp_l (n,) [rad/s]. integrates: False leaves out the last two
    arguments and port_l, which cost as much as the law.
    """
    n = law.robot.n
    load, matched = Load.named(n, integrates), ca.SX.sym("matched", n)
    inputs, outputs = law.measured_expressions(flow(law.robot, diagonal=True, load=load), -matched)
    arguments = inputs | {"known": load.known, "matched": matched}
    if integrates:
        arguments |= {"integral": load.integral, "integral_gain": load.gain}
    found = outputs | {"port_m": outputs["s_m"]}
    names = OUTPUTS if integrates else OUTPUTS[:-1]
    return dense_function("loaded_command", arguments, {name: found[name] for name in names}, cse=True)
