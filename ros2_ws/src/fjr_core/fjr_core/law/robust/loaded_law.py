# SPDX-License-Identifier: Apache-2.0
"""Extend the law by compensation of known load torques and by integral action against unknown ones."""

from __future__ import annotations

import casadi as ca

from ...numerics.casadi_function import dense_function
from ..lie_derivative import Load, flow
from ..vdpbc.law import TrackingLaw

OUTPUTS = ("u", "V", "dissipation", "port_m", "port_l")


def loaded_expression(law: TrackingLaw, integrates: bool = True) -> ca.Function:
    """Return the CasADi function of the law u(x, x, t) with a load, not compiled.

    (position (2n,), velocity (2n,), jets (n, 5), gains (g,), known (n, 3), matched (n,), integral (n,),
    integral_gain (n, n)) -> OUTPUTS. known: link torque with two derivatives. matched (n,) [N m]: motor torque. The law
    compensates both. integral (n,) [N m]: state of the integral action with the symmetric gain integral_gain
    [N m/rad] (lie_derivative.Load). V [J] without the energy of the integral. dissipation [W]: see
    vdpbc.integral_action. port_m = s_m = dV/dp_m, port_l = dV/dp_l (n,) [rad/s]. integrates = False omits the last
    two arguments and port_l, which cost as much as the law.
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
