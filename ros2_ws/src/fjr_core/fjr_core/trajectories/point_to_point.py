# SPDX-License-Identifier: Apache-2.0
"""References that rest: standing still, and from point to point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics import checks
from ..numerics.checks import Array, freeze, joint_vector, positive
from .bounds import ROWS, Extremes
from .piecewise_polynomial import Pieces
from .reference import JETS


def standing(q: ArrayLike, dq: ArrayLike = 0.0) -> Array:
    """Jets (5, n) at q (n,) [rad] with velocity dq [rad/s] and no higher derivatives."""
    q = joint_vector("q", q)
    jets = np.zeros((JETS, len(q)))
    jets[0], jets[1] = q, checks.vector("dq", dq, len(q), TrajectoryError)
    return jets


@dataclass(frozen=True, eq=False)
class Hold:
    """q_ld(t) = q (n,) [rad] for ever. Raises TrajectoryError when q is not a vector of finite numbers."""

    q: ArrayLike

    def __post_init__(self) -> None:
        freeze(self, "q", joint_vector("q", self.q))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(np.size(self.q))

    @property
    def end(self) -> float:
        """It always stands."""
        return 0.0

    @cached_property
    def _jets(self) -> Array:
        return standing(self.q)

    def jets(self, t: ArrayLike) -> Array:
        """q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        return np.tile(self._jets, (np.size(t), 1, 1)) if np.ndim(t) else self._jets.copy()

    def configurations(self, k: int) -> Array:
        """q, k times (k, n) [rad]."""
        return np.tile(np.asarray(self.q), (k, 1))

    def extremes(self, t0: float, t1: float) -> Extremes:
        """Position, no velocity, no acceleration."""
        rows, at = self._jets[:ROWS], np.full((ROWS, self.n), t0)
        return Extremes(rows, rows, at, at)


@dataclass(frozen=True, eq=False)
class PointToPoint:
    """From q0 to q1 (n,) [rad] within `duration` [s], four derivatives zero at both ends; stands before and after.

    returns: after a dwell [s] it goes back in the same time, after another dwell forth again, and so on for ever.
    The speed peaks in the middle, at 2.46 |q1 - q0| / duration.
    Raises TrajectoryError for other shapes, numbers that are not finite, a duration that is not positive, a dwell < 0.
    """

    q0: ArrayLike
    q1: ArrayLike
    duration: float
    dwell: float = 0.0
    returns: bool = False

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
        """The duration; infinite where it returns."""
        return np.inf if self.returns else self.duration

    @property
    def period(self) -> float:
        """Of one way forth and back with both dwells [s]; for one that returns."""
        return 2 * (self.duration + self.dwell)

    @cached_property
    def pieces(self) -> Pieces:
        """The way, or one period of it where it returns."""
        times, rests = [0.0, self.duration], [standing(self.q0), standing(self.q1)]
        if self.returns:
            back = self.period / 2
            times, rests = [*times, back, back + self.duration], [*rests, rests[1], rests[0]]
        kept = np.diff(times, prepend=-1.0) > 0
        return Pieces(np.array(times)[kept], np.array(rests)[kept])

    def jets(self, t: ArrayLike) -> Array:
        """q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        return self.pieces.jets(np.maximum(t, 0.0) % self.period if self.returns else t)

    def configurations(self, k: int) -> Array:
        """k configurations (k, n) [rad], evenly on the way."""
        return np.linspace(np.asarray(self.q0), np.asarray(self.q1), k)

    def extremes(self, t0: float, t1: float) -> Extremes:
        """Bounds of position, velocity and acceleration from t0 to t1 [s]; of all times where it returns."""
        return self.pieces.extremes(0.0, self.period) if self.returns else self.pieces.extremes(t0, t1)
