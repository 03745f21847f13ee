# SPDX-License-Identifier: Apache-2.0
"""From one reference into another without a step in any of the four derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics import checks
from ..numerics.checks import Array, number, positive
from .bounds import Extremes
from .piecewise_polynomial import Pieces
from .reference import JETS, Reference


@dataclass(frozen=True, eq=False)
class Joined:
    """One polynomial of degree 9 in `way`, from its first time to its last, then `target`; made by join."""

    way: Pieces
    target: Reference

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.target.n

    @property
    def joined(self) -> float:
        """Time [s] from which on it is the target."""
        return float(self.way.times[-1])

    @property
    def end(self) -> float:
        """The target's end, but not before it is joined."""
        return max(self.joined, self.target.end)

    def jets(self, t: ArrayLike) -> Array:
        """q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        if not np.ndim(t):
            return (self.way if t < self.joined else self.target).jets(t)  # type: ignore[operator]
        t = np.asarray(t, dtype=float)
        jets, before = self.target.jets(t), t < self.joined
        jets[before] = self.way.jets(t[before])
        return jets

    def configurations(self, k: int) -> Array:
        """k configurations (k, n) [rad]: a quarter of them on the way, the others the target's."""
        times = np.linspace(self.way.times[0], self.joined, k // 4)
        return np.vstack([self.way.jets(times)[:, 0], self.target.configurations(k - k // 4)])

    def extremes(self, t0: float, t1: float) -> Extremes:
        """Bounds of position, velocity and acceleration from t0 to t1 [s]."""
        if t0 >= self.joined:
            return self.target.extremes(t0, t1)
        way = self.way.extremes(t0, min(t1, self.joined))
        return way if t1 <= self.joined else way.with_other(self.target.extremes(self.joined, t1))


def join(jets0: ArrayLike, t0: float, target: Reference, duration: float) -> Joined:
    """The reference with jets0 (5, n) at t0 [s] that is `target` from t0 + duration on, of class C^4 between.

    Between, it is one polynomial of degree 9; before t0 it stands at its first position. Raises TrajectoryError
    when jets0 has another shape or is not finite, or the duration is not positive.
    """
    jets0 = checks.finite("jets0", jets0, TrajectoryError)
    if jets0.shape != (JETS, target.n):
        raise TrajectoryError(f"jets0 has shape {jets0.shape}; expected ({JETS}, {target.n}), value and derivatives")
    positive("duration", duration)
    t0 = number("t0", t0)
    t1 = t0 + duration
    while isinstance(target, Joined) and target.joined <= t1:
        target = target.target
    way = Pieces(np.array([t0, t1]), np.stack([jets0, target.jets(t1)]))
    if not way.finite:
        raise TrajectoryError(f"duration is {duration} s at {t0} s; expected a longer one")
    return Joined(way, target)


@dataclass(frozen=True, eq=False)
class Shifted:
    """`reference` with its time 0 at t0 [s]; made by shifted."""

    reference: Reference
    t0: float

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.reference.n

    @property
    def end(self) -> float:
        """The reference's end on the new time line."""
        return self.reference.end + self.t0

    def jets(self, t: ArrayLike) -> Array:
        """q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        return self.reference.jets(np.subtract(t, self.t0) if np.ndim(t) else t - self.t0)  # type: ignore[operator]

    def configurations(self, k: int) -> Array:
        """k configurations (k, n) [rad], the reference's."""
        return self.reference.configurations(k)

    def extremes(self, t0: float, t1: float) -> Extremes:
        """Bounds of position, velocity and acceleration from t0 to t1 [s]."""
        return self.reference.extremes(t0 - self.t0, t1 - self.t0).later(self.t0)


def shifted(reference: Reference, t0: float) -> Reference:
    """`reference` with its time 0 at t0 [s]. Raises TrajectoryError when t0 is not finite."""
    t0 = number("t0", t0)
    while isinstance(reference, Shifted):
        t0 += reference.t0
        reference = reference.reference
    return Shifted(reference, t0) if t0 else reference
