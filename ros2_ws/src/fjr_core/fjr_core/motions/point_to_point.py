# SPDX-License-Identifier: Apache-2.0
"""References with stationary ends: hold, and point to point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics import checks
from ..numerics.checks import Array, freeze, joint_vector, positive
from ..numerics.one_line import one_line
from .bounds import ROWS, MotionBounds
from .piecewise_polynomial import PiecewisePolynomial
from .reference import JETS


def standing(q: ArrayLike, dq: ArrayLike = 0.0) -> Array:
    """Return jets (5, n) at q (n,) [rad] with velocity dq [rad/s] and zero higher derivatives."""
    q = joint_vector("q", q)
    jets = np.zeros((JETS, len(q)))
    jets[0], jets[1] = q, checks.vector("dq", dq, len(q), TrajectoryError)
    return jets


@dataclass(frozen=True, eq=False)
class Hold:
    """Constant reference q_ld(t) = q (n,) [rad]. Raises TrajectoryError unless q is a vector of finite numbers."""

    q: ArrayLike

    __repr__ = one_line

    def __post_init__(self) -> None:
        freeze(self, "q", joint_vector("q", self.q))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(np.size(self.q))

    @property
    def end(self) -> float:
        """Zero: the reference is constant from the start."""
        return 0.0

    @cached_property
    def _jets(self) -> Array:
        return standing(self.q)

    def jets(self, t: ArrayLike) -> Array:
        """Return q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        return np.tile(self._jets, (np.size(t), 1, 1)) if np.ndim(t) else self._jets.copy()

    def configurations(self, k: int) -> Array:
        """Return q repeated k times, (k, n) [rad]."""
        return np.tile(np.asarray(self.q), (k, 1))

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return constant bounds of the position and zero bounds of velocity and acceleration."""
        rows, at = self._jets[:ROWS], np.full((ROWS, self.n), t0)
        return MotionBounds(rows, rows, at, at)


@dataclass(frozen=True, eq=False)
class PointToPoint:
    """Motion from q0 to q1 (n,) [rad] in `duration` [s] with four zero derivatives at both ends; constant outside.

    returns: periodic motion forth and back, with a dwell [s] at each end. The peak velocity is
    2.46 |q1 - q0| / duration at half the duration.
    Raises TrajectoryError for a wrong shape, non-finite numbers, a duration that is not positive or a dwell < 0.
    """

    q0: ArrayLike
    q1: ArrayLike
    duration: float
    dwell: float = 0.0
    returns: bool = False

    __repr__ = one_line

    def __post_init__(self) -> None:
        freeze(self, "q0", joint_vector("q0", self.q0))
        freeze(self, "q1", checks.vector("q1", self.q1, self.n, TrajectoryError))
        positive("duration", self.duration)
        if not (np.isfinite(self.dwell) and self.dwell >= 0):
            raise TrajectoryError(f"dwell is {self.dwell} s; expected 0 or more")

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(np.size(self.q0))

    @property
    def end(self) -> float:
        """The duration [s]; infinite if it returns."""
        return np.inf if self.returns else self.duration

    @property
    def period(self) -> float:
        """Period [s] of the motion forth and back, including both dwells."""
        return 2 * (self.duration + self.dwell)

    @cached_property
    def pieces(self) -> PiecewisePolynomial:
        """The motion as a piecewise polynomial; one period if it returns."""
        times, knots = [0.0, self.duration], [standing(self.q0), standing(self.q1)]
        if self.returns:
            back = self.period / 2
            times, knots = [*times, back, back + self.duration], [*knots, knots[1], knots[0]]
        kept = np.diff(times, prepend=-1.0) > 0
        return PiecewisePolynomial(np.array(times)[kept], np.array(knots)[kept])

    def jets(self, t: ArrayLike) -> Array:
        """Return q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        return self.pieces.jets(np.maximum(t, 0.0) % self.period if self.returns else t)

    def configurations(self, k: int) -> Array:
        """Return k configurations (k, n) [rad], equally spaced between q0 and q1."""
        return np.linspace(np.asarray(self.q0), np.asarray(self.q1), k)

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return bounds of position, velocity and acceleration from t0 to t1 [s]; of a period if it returns."""
        return self.pieces.motion_bounds(0.0, self.period) if self.returns else self.pieces.motion_bounds(t0, t1)
