# SPDX-License-Identifier: Apache-2.0
"""Track a spline with 16-bit encoders and no velocity sensor; an observer estimates the velocities."""

import numpy as np

import fjr_core as fjr

PERIOD = 1e-3  # s
STEP = 2 * np.pi / 2**16  # rad, of a 16-bit encoder

robot = fjr.single_link(stiffness=31.0)
law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
plant, observer = fjr.Plant(robot), fjr.VelocityObserver(robot, bandwidth=150.0)
reference = fjr.Spline(
    times=[0.0, 1.0, 2.0, 3.0], positions=[[0.0], [0.8], [-0.4], [0.2]]
)  # s, rad; C^4, at rest at the ends

x, u, errors = robot.state(0.1, 0.1, 0.0, 0.0), np.zeros(1), []
for k in range(4000):
    q_l, q_m = np.round(x[:2] / STEP).reshape(2, 1) * STEP
    observer.update(round(k * PERIOD * 1e9), q_l, q_m, u)
    u, V = law.measured_command(observer.state[:2], observer.state[2:], reference.jets(k * PERIOD))
    errors.append(x[0] - reference.jets(k * PERIOD)[0, 0])
    x = plant.step(x, u, PERIOD)

rms = np.sqrt(np.mean(np.square(errors[1000:])))
print(f"tracking error: {1e3 * errors[0]:.0f} mrad at the start, RMS after 1 s {1e3 * rms:.1e} mrad")
