# SPDX-License-Identifier: Apache-2.0
"""Interface of reference trajectories of class C^4: value and four exact derivatives at every time."""

from __future__ import annotations

from math import inf
from typing import Protocol

from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics.checks import Array, kind_of
from .bounds import MotionBounds

REFERENCE_DERIVATIVES = 4  # q_ld .. d4q_ld: the law has relative degree four
JETS = REFERENCE_DERIVATIVES + 1


class Reference(Protocol):
    """A reference trajectory q_ld(t) of class C^4 in n joints."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def end(self) -> float:
        """Time [s] after which the reference is constant; infinite by default."""
        return inf

    def jets(self, t: ArrayLike) -> Array:
        """Return q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""

    def configurations(self, k: int) -> Array:
        """Return k configurations (k, n) [rad], distributed evenly over the reference."""

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return bounds of position, velocity and acceleration from t0 to t1 [s]; t1 may be infinite."""


def check_reference(reference: object) -> None:
    """Raise TrajectoryError unless `reference` has the members n and jets of a Reference; a function has not."""
    if isinstance(reference, type) or not (hasattr(reference, "n") and hasattr(reference, "jets")):
        raise TrajectoryError(
            f"reference is {kind_of(reference)}; expected a reference, e.g. fjr.Sine(1.0, 1.0) or "
            "fjr.Spline(times, positions): the law needs four exact derivatives"
        )
