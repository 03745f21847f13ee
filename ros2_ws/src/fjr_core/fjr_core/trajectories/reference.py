# SPDX-License-Identifier: Apache-2.0
"""What a reference of class C^4 is (value and four exact derivatives at every time)."""

from __future__ import annotations

from typing import Protocol

from numpy.typing import ArrayLike

from ..numerics.checks import Array
from .bounds import Extremes

REFERENCE_DERIVATIVES = 4  # q_ld .. d4q_ld: the law has relative degree four
JETS = REFERENCE_DERIVATIVES + 1


class Reference(Protocol):
    """What the law needs of a reference, and what is asked of it before it is followed."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def end(self) -> float:
        """Time [s] from which on it stands still; infinite for an endless one."""

    def jets(self, t: ArrayLike) -> Array:
        """q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""

    def configurations(self, k: int) -> Array:
        """k configurations (k, n) [rad], evenly over where the links will be."""

    def extremes(self, t0: float, t1: float) -> Extremes:
        """Bounds of position, velocity and acceleration from t0 to t1 [s]; t1 may be infinite."""
