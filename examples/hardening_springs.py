# SPDX-License-Identifier: Apache-2.0
"""Track with springs that carry twice the torque of straight ones at 5 mrad, by the curve or by a stiffness."""

from dataclasses import replace

import numpy as np

import fjr_core as fjr

TWICE_AT = 5e-3  # rad
STIFFER = np.geomspace(1.0, 16.0, 13)  # straight springs, relative to the stiffness without deflection


def tracked(law: fjr.TrackingLaw, robot: fjr.Robot, reference: fjr.Sine) -> tuple[float, float]:
    """Return largest |q_l - q_ld| [rad] in the last of three seconds and largest |u| [N m], infinite if unstable."""
    jets = reference.jets(0.0)
    q_l, still = jets[0], jets[1]
    x0 = robot.state(q_l, q_l + robot.deflection(robot.grad_P_l(q_l)), still, still)
    try:
        run = fjr.simulate(fjr.Plant(robot, compile=True), law, reference, x0, 3.0, 1e-3, 2.5e-4)
    except fjr.StateError:
        return np.inf, np.inf
    error = np.abs(run.x[:, : robot.n] - run.jets[:, 0])
    return float(np.max(error[run.t > 2.0])), float(np.max(np.abs(run.u)))


print("robot       law knows                 |q_l - q_ld|     |u|   rate beta")
for name, straight, amplitude in (
    ("two_link", fjr.planar_two_link(), [0.4, 0.3]),
    ("paper", fjr.single_link(stiffness=31.0), [1.0]),
):
    robot = replace(straight, cubic=np.diag(straight.K) / TWICE_AT**2)
    reference = fjr.Sine(amplitude=amplitude, frequency=2.0)
    gains = fjr.PAPER_GAINS
    laws = {"the curve": fjr.TrackingLaw(robot, gains, compile=True)}
    for factor in STIFFER:
        known = f"K zeta, {factor:.3g} K" if factor > 1 else "K zeta"
        laws[known] = fjr.TrackingLaw(replace(straight, K=factor * straight.K), gains, compile=True)
    results = {known: tracked(law, robot, reference) for known, law in laws.items()}
    best = min((known for known in results if "," in known), key=lambda known: results[known][0])
    for known in ("the curve", best, "K zeta"):
        error, peak = results[known]
        rate = laws[known].rate()
        proven = f"{rate.beta:8.2f} 1/s, proven" if rate.proven and known == "the curve" else "    none: not its model"
        print(f"{name:10}  {known:22} {1e3 * error:10.3f} mrad {peak:7.2f} {proven}")
