# SPDX-License-Identifier: Apache-2.0
"""Simulate a three-link arm of your own bodies, gains and reference; print its rate, peak effort and error."""

import numpy as np

import fjr_core as fjr

UP, ACROSS = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)  # joint axes
SHAPE = np.diag([0.002, 0.012, 0.012])  # kg m^2 about the centre of mass of a link of 1 kg


def link(place, axis, mass, com):
    """Return a joint at `place` [m] of the link before, and its link with the centre of mass `com` [m]."""
    return fjr.Body(np.eye(3), place, axis, mass, com, mass * SHAPE)


links = fjr.serial_chain(
    [
        link((0.0, 0.0, 0.3), UP, 2.0, (0.02, 0.01, 0.05)),
        link((0.05, 0.0, 0.1), ACROSS, 1.5, (0.15, 0.02, 0.03)),
        link((0.3, 0.0, 0.0), ACROSS, 0.7, (0.12, -0.01, 0.02)),
    ]
)
robot = fjr.Robot(links, M_m=[0.05, 0.04, 0.02], K=[90.0, 90.0, 40.0], D_l=0.2, D_m=0.02, B_m=1.0)
gains = fjr.Gains(Lambda_l=8.0, Pi_l=20.0, K_ld=[1.5, 1.5, 0.5], Lambda_m=12.0, Pi_m=60.0, K_md=[1.2, 0.9, 0.5])
law = fjr.TrackingLaw(robot, gains)
reference = fjr.Sine(amplitude=[0.5, 0.4, 0.7], frequency=[2.0, 2.0, 3.0], offset=[0.0, 0.5, -0.5])
x0 = robot.state(q_l=[0.1, 0.6, -0.4], q_m=[0.1, 0.6, -0.4], dq_l=0.0, dq_m=0.0)

rate = law.rate()
print(f"beta = {rate.beta:.2f} 1/s ({'proven' if rate.proven else 'sampled'}), by eq. (50) {rate.beta_paper:.2f} 1/s")

run = fjr.simulate(fjr.Plant(robot), law, reference, x0, duration=3.0, sample_period=1e-3)
error = np.abs(run.x[:, : robot.n] - run.jets[:, 0])
print(
    f"peak effort {np.max(np.abs(run.u), axis=0).round(2)} N m, error after 2 s {1e3 * error[run.t > 2].max():.1e} mrad"
)
