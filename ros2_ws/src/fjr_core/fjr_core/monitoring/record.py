# SPDX-License-Identifier: Apache-2.0
"""A record of a run: what was measured and sent at each instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import StateError
from ..numerics.checks import Array, positive
from ..numerics.one_line import joints, span
from ..trajectories.reference import JETS


@dataclass(frozen=True)
class Record:
    """Measured states and commands at k instants.

    t (k,) [s]: time stamps. position, velocity (k, 2n) [rad, rad/s]: links, then motors. jets (k, 5, n): reference.
    u (k, n) [N m]: command for each state, NaN: none. u_applied (k, n) [N m]: measured effort of the motors at each
    state, or None. sent, answered (k,) [s]: send times of states and commands, or None. sample_period [s].
    effort_limit (n,) [N m]: inf for none. lockstep: the robot waits for each command, so that send times carry no
    information. Raises StateError for wrong shapes and a sample period that is not positive.
    """

    t: Array
    position: Array
    velocity: Array
    jets: Array
    u: Array
    u_applied: Array | None
    sent: Array | None
    answered: Array | None
    sample_period: float
    effort_limit: Array
    lockstep: bool = False

    def __repr__(self) -> str:
        n = joints(self.u.shape[1])
        return f"Record({n}, {len(self.t)} instants, {span(self.t)}, sample_period={self.sample_period:.4g} s)"

    def __post_init__(self) -> None:
        k, n = np.shape(self.u) if np.ndim(self.u) == 2 else (-1, -1)
        shapes = {"t": (k,), "position": (k, 2 * n), "velocity": (k, 2 * n), "jets": (k, JETS, n), "u": (k, n)}
        optional = {"u_applied": (k, n), "sent": (k,), "answered": (k,)}
        shapes |= {name: shape for name, shape in optional.items() if getattr(self, name) is not None}
        for name, shape in {**shapes, "effort_limit": (n,)}.items():
            if np.shape(getattr(self, name)) != shape:
                raise StateError(f"{name} has shape {np.shape(getattr(self, name))}; expected {shape}")
        positive("sample_period", self.sample_period, StateError)
