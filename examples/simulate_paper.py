# SPDX-License-Identifier: Apache-2.0
"""Simulate the example of the paper for both stiffnesses, in continuous time and at 1 kHz."""

import numpy as np

import fjr_core as fjr

reference = fjr.Sine(amplitude=1.0, frequency=1.0)  # q_ld = sin t

print("stiffness         loop    peak effort   |q_l - q_ld| after 2 s     rate beta")
for stiffness in (31.0, 3.1):
    robot = fjr.single_link(stiffness=stiffness)
    plant, law = fjr.Plant(robot), fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
    x0 = robot.state(q_l=0.5, q_m=0.5, dq_l=0.0, dq_m=0.0)
    for name, period in (("continuous", None), ("1 kHz hold", 1e-3)):
        run = fjr.simulate(plant, law, reference, x0, duration=5.0, sample_period=period)
        error = np.abs(run.x[:, 0] - run.jets[:, 0, 0])
        peak, late = np.max(np.abs(run.u)), np.max(error[run.t > 2.0])
        print(
            f"{stiffness:4.1f} N m/rad {name:>10} {peak:10.3f} N m {1e3 * late:20.1e} mrad {law.rate().beta:9.2f} 1/s"
        )
