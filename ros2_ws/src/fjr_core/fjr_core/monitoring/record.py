# SPDX-License-Identifier: Apache-2.0
"""A record of a run: what was measured and sent at each instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import StateError
from ..numerics.checks import Array
from ..trajectories.reference import JETS


@dataclass(frozen=True)
class Record:
    """What was measured and sent at k instants, by the stamps.

    t (k,) [s]. position, velocity (k, 2n): of links, then motors. jets (k, 5, n): of the reference. u (k, n) [N m]:
    the effort that answered each state, nan: none did. u_applied (k, n) [N m]: what the motors gave at each state, by
    measurement, or None. sent, answered (k,) [s]: when states and answers went, or None. sample_period [s].
    effort_limit (n,) [N m]: inf for none. Raises StateError for shapes that do not fit.
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

    def __post_init__(self) -> None:
        k, n = np.shape(self.u) if np.ndim(self.u) == 2 else (-1, -1)
        shapes = {"t": (k,), "position": (k, 2 * n), "velocity": (k, 2 * n), "jets": (k, JETS, n), "u": (k, n)}
        optional = {"u_applied": (k, n), "sent": (k,), "answered": (k,)}
        shapes |= {name: shape for name, shape in optional.items() if getattr(self, name) is not None}
        for name, shape in {**shapes, "effort_limit": (n,)}.items():
            if np.shape(getattr(self, name)) != shape:
                raise StateError(f"{name} has shape {np.shape(getattr(self, name))}; expected {shape}")
        if not (np.isfinite(self.sample_period) and self.sample_period > 0):
            raise StateError(f"sample_period is {self.sample_period} s; expected a positive finite number")
