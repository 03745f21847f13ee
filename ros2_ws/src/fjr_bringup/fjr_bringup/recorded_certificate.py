# SPDX-License-Identifier: Apache-2.0
"""V, its exact predicted rate, the energy H and the dissipated power at every recorded state, from the model alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_bringup.bag import Array
from fjr_core.vdpbc.law import TrackingLaw


@dataclass(frozen=True)
class Series:
    """At k states: V [J], dV [W] as the law's closed loop has it, H [J], dissipated [W] by the joints' own damping."""

    V: Array
    dV: Array
    H: Array
    dissipated: Array


def series(law: TrackingLaw, position: Array, velocity: Array, jets: Array) -> Series:
    """Of positions and velocities (k, 2n) and jets (k, 5, n); NaN where a state is not complete."""
    robot, n = law.robot, law.robot.n
    found = np.full((4, len(position)), np.nan)
    for k, (q, dq) in enumerate(zip(position, velocity, strict=True)):
        if np.isfinite(q).all() and np.isfinite(dq).all():
            x = robot.state(q[:n], q[n:], dq[:n], dq[n:])
            value = law.evaluate(x, x, jets[k])
            dissipated = dq[:n] @ robot.D_l @ dq[:n] + dq[n:] @ robot.D_m @ dq[n:]
            found[:, k] = value.V, value.dV, robot.hamiltonian(x), dissipated
    return Series(*found)
