# SPDX-License-Identifier: Apache-2.0
"""Enclose the solutions of the error system during one sample (Picard iteration)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_core.numerics.intervals import Interval

from ..verification.interval_matrices import ABOVE
from .error_system import ErrorSystem

STEPS = 4
"""Steps of a sample, each with a box that no solution leaves."""
TRIALS = 12
"""Attempts to find such a box."""


@dataclass(frozen=True, eq=False)
class Flow:
    """Solutions during one sample, as deviations from the centre (m, k).

    start: bounds at the start. grown: bounds of the change. box: bounds throughout, infinite without a bound. jets: the
    reference over the piece and the sample after it.
    """

    start: Array
    grown: Array
    box: Array
    jets: Interval

    @property
    def reached(self) -> Array:
        """Bounds (m, k) at every instant of the sample."""
        return np.asarray(ABOVE * (self.start + self.grown))


def enclosed_flow(system: ErrorSystem, centre: Array, start: Array, jets: Interval, h: float) -> Flow:
    """Return bounds of solutions that start with |chi - c| at most start (s, k), c = centre (m, k), during h [s].

    Rows s .. m of chi, the effort error w without a delay, start at c. w may drop to zero at any time.
    """
    first = np.zeros_like(centre)
    first[: len(start)] = start
    first[-system.n :] += np.abs(centre[-system.n :])  # w after the change of the effort
    reached, box = first, first
    for _ in range(STEPS):
        box, rates = _step(system, centre, jets, reached, h / STEPS)
        reached = reached + ABOVE * h / STEPS * rates
        if not np.isfinite(reached).all():
            break
    return Flow(first, ABOVE * (reached - first), box, jets)


def _step(system: ErrorSystem, centre: Array, jets: Interval, reached: Array, step: float) -> tuple[Array, Array]:
    """Return bounds of |chi - c| and of the field over a step [s] from |chi - c| <= reached; infinite without."""
    box = reached
    for _ in range(TRIALS):
        rates = system.enclosed_field(Interval(centre, box), jets)[0].magnitude
        end = reached + ABOVE * step * rates
        if np.all(end <= box):
            return box, rates
        box = 1.02 * end + 1e-300
    return np.full_like(box, np.inf), np.full_like(box, np.inf)
