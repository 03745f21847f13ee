# SPDX-License-Identifier: Apache-2.0
"""Loops, and their one-sample map by SciPy's DOP853 from public functions of plant and law."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

import fjr_core as fjr
from fjr_core.numerics.checks import Array
from fjr_proofs.sampled_contraction.error_system import ErrorSystem

FAST_SINE = fjr.Sine(0.3, 10.0)
CUBIC = fjr.Gains(Lambda_l=10.0, Pi_l=20.0, K_ld=0.6, Lambda_m=15.0, Pi_m=60.0, K_md=0.3, Gamma_l=5.0, Gamma_m=8.0)
TWO_LINK = fjr.Gains(
    Lambda_l=16.0,
    Pi_l=[[32.22, 4.272], [4.272, 4.229]],
    K_ld=[[1.697, 0.225], [0.225, 0.2227]],
    Lambda_m=16.0,
    Pi_m=[40.0, 25.0],
    K_md=[0.32, 0.16],
)


def joint(gains: fjr.Gains = fjr.PAPER_GAINS, stiffness: float = 31.0) -> fjr.TrackingLaw:
    return fjr.TrackingLaw(fjr.single_link(stiffness=stiffness), gains)


def two_link() -> fjr.TrackingLaw:
    return fjr.TrackingLaw(fjr.planar_two_link(), TWO_LINK)


def derivatives(reference: fjr.Sine, t: float) -> Array:
    """Return q_ld .. d6q_ld (n, 7)."""
    rows = zip(*(np.broadcast_to(v, reference.n) for v in (reference.amplitude, reference.frequency)), strict=True)
    waves = [[a * w**k * np.sin(w * t + k * np.pi / 2) for k in range(7)] for a, w in rows]
    found = np.array(waves)
    found[:, 0] += reference.offset
    return found


def state(system: ErrorSystem, chi: Array, reference: fjr.Sine, t: float) -> Array:
    """Return the state x (4n,) that has the errors chi at time t."""
    position, velocity = (part.full().ravel() for part in system.state(chi, derivatives(reference, t)))
    return system.law.robot.state(*np.split(position, 2), *np.split(velocity, 2))


def errors(law: fjr.TrackingLaw, x: Array, jets: Array) -> Array:
    """Return (qt_l, qt_m, s_l, s_m) (4n,) of a state x by the law's public evaluation."""
    n, found = law.robot.n, law.evaluate(x, x, jets)
    s_l = np.linalg.solve(law.robot.M_l(x[:n]), found.sigma_l)
    s_m = np.linalg.solve(law.robot.M_m, found.sigma_m)
    return np.concatenate([found.q_tilde_l, found.q_tilde_m, s_l, s_m])


def one_sample(system: ErrorSystem, chi: Array, reference: fjr.Sine, t: float, h: float, tau: float) -> Array:
    """Return chi one sample later, if the effort changes after tau [s]."""
    law, plant = system.law, fjr.Plant(system.law.robot)
    x = state(system, chi, reference, t)
    now = law.command(x, reference.jets(t))
    for effort, duration in ((now + chi[4 * law.robot.n :], tau), (now, h - tau)):
        if duration:
            x = solve_ivp(
                lambda _, y, u=effort: plant.derivative(y, u), (0, duration), x, "DOP853", rtol=1e-12, atol=1e-13
            ).y[:, -1]
    jets = reference.jets(t + h)
    return np.concatenate([errors(law, x, jets), now - law.command(x, jets)])
