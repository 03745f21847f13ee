# SPDX-License-Identifier: Apache-2.0
"""Synthesise gains for a seven-joint arm from its URDF, check the sampled loop and simulate it; needs fjr_design."""

from pathlib import Path

import numpy as np

import fjr_core as fjr

URDF = Path(__file__).parents[1] / "ros2_ws/src/fjr_bringup/robots/arm7.urdf"
PERIOD = 1e-3  # s

robot = fjr.robot_from_urdf(
    URDF,
    joints=[f"joint{i}" for i in range(1, 8)],
    stiffness=[10000, 10000, 8000, 8000, 5000, 3000, 3000],  # N m/rad
    motor_inertia=[0.6, 0.6, 0.45, 0.45, 0.2, 0.2, 0.2],  # kg m^2, reflected
    link_damping=0.3,
    motor_damping=0.8,
)
reference = fjr.Sine(amplitude=[0.3] * 7, frequency=np.pi, offset=[0, 0.5, 0.2, -1.2, -0.2, 0.8, 0.4])
along = reference.jets(np.linspace(0, 2, 32))[:, 0]  # configurations (k, 7) of one period

gains = fjr.synthesize(robot, beta=7.0, sample_period=PERIOD, configurations=along)
law = fjr.TrackingLaw(robot, gains, compile=True)
found = fjr.check(law, PERIOD, configurations=along)
print(f"beta {law.rate(along).beta:.2f} 1/s; spectral radius {found.spectral_radius:.4f} at 1 kHz")
print(f"delay margin {found.delay_margin:.2f} samples; stable down to {found.lowest_stable_rate:.0f} Hz")

q_l = reference.jets(0.0)[0] + 0.05  # initial error of 0.05 rad at every joint; the springs carry the weight
q_m = q_l + np.linalg.solve(robot.K, robot.grad_P_l(q_l))
x0 = robot.state(q_l, q_m, np.zeros(7), np.zeros(7))
run = fjr.simulate(fjr.Plant(robot, compile=True), law, reference, x0, 3.0, PERIOD)
error = np.abs(run.x[:, :7] - run.jets[:, 0]).max(axis=1)
print(f"error {1e3 * error[0]:.3g} mrad at first, {1e3 * error[run.t > 2].max():.2g} mrad after 2 s")
print("peak efforts", np.abs(run.u).max(axis=0).round(1), "of", robot.limits.effort, "N m")
