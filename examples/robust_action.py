# SPDX-License-Identifier: Apache-2.0
"""Compare robust options on the paper's joint at 1 kHz, with an unmodelled load and with a delay of one sample."""

from dataclasses import replace

import casadi as ca
import numpy as np

import fjr_core as fjr
from fjr_core.robust.law import Robust, sampled_law

PERIOD = 1e-3  # s
robot = fjr.single_link(stiffness=31.0)
law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
reference = fjr.Sine(amplitude=1.0, frequency=1.0)  # q_ld = sin t

q = ca.SX.sym("q", 1)  # robot with 0.3 N m on its link: P_l - 0.3 q_l
P_l = ca.Function("P_l", [q], [robot.links.P_l(q) - 0.3 * q])
grad_P_l = ca.Function("grad_P_l", [q], [robot.links.grad_P_l(q) - 0.3])
with_load = replace(robot, links=replace(robot.links, P_l=P_l, grad_P_l=grad_P_l))

options = {
    "none": Robust(),
    "residual": Robust(residual_gain=60.0),
    "integral": Robust(integral_gain=5.0),
    "prediction": Robust(delay=PERIOD),
}
cases = {"0.3 N m on the link": (with_load, 0.0), "one sample late": (robot, PERIOD)}

print("case                  robust action   |q_l - q_ld|, RMS of the last second")
for case, (actual, delay) in cases.items():
    plant, x0 = fjr.Plant(actual), actual.state(q_l=0.5, q_m=0.5, dq_l=0.0, dq_m=0.0)
    for name, robust in options.items():
        run = fjr.simulate(plant, sampled_law(law, robust), reference, x0, 6.0, PERIOD, delay=delay)
        error = (run.x[:, 0] - run.jets[:, 0, 0])[run.t > 5.0]
        print(f"{case:20}  {name:>13}   {1e3 * np.sqrt(np.mean(error**2)):7.2g} mrad")
