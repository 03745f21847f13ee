# SPDX-License-Identifier: Apache-2.0
"""Transition between references that is continuous in the first four derivatives, and time shift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics import checks
from ..numerics.checks import Array, number, positive
from ..numerics.one_line import one_line, span
from .piecewise_polynomial import PiecewisePolynomial
from .reference import JETS, MotionBounds, Reference, check_reference


@dataclass(frozen=True, eq=False)
class Transition:
    """A polynomial of degree 9, `segment`, followed by `target`; created by transition."""

    segment: PiecewisePolynomial
    target: Reference

    def __repr__(self) -> str:
        return f"Transition({span(self.segment.knot_times)}, then {self.target!r})"

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.target.n

    @property
    def transition_end(self) -> float:
        """Time [s] from which on the reference equals the target."""
        return float(self.segment.knot_times[-1])

    @property
    def end(self) -> float:
        """End [s] of the target, at least the end of the transition."""
        return max(self.transition_end, self.target.end)

    def jets(self, t: ArrayLike) -> Array:
        """Return q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        if not np.ndim(t):
            return (self.segment if t < self.transition_end else self.target).jets(t)  # type: ignore[operator]
        t = np.asarray(t, dtype=float)
        jets, before = self.target.jets(t), t < self.transition_end
        jets[before] = self.segment.jets(t[before])
        return jets

    def configurations(self, k: int) -> Array:
        """Return k configurations (k, n) [rad]: a quarter of them in the transition, the others of the target."""
        times = np.linspace(self.segment.knot_times[0], self.transition_end, k // 4)
        return np.vstack([self.segment.jets(times)[:, 0], self.target.configurations(k - k // 4)])

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return bounds of position, velocity and acceleration from t0 to t1 [s]."""
        if t0 >= self.transition_end:
            return self.target.motion_bounds(t0, t1)
        bounds = self.segment.motion_bounds(t0, min(t1, self.transition_end))
        return bounds if t1 <= self.transition_end else bounds.union(self.target.motion_bounds(self.transition_end, t1))


def transition(jets0: ArrayLike, t0: float, target: Reference, duration: float) -> Transition:
    """Return the reference with jets0 (5, n) at t0 [s] that equals `target` from t0 + duration [s] on.

    The transition is one polynomial of degree 9, so the reference is of class C^4; before t0 it is constant. Raises
    TrajectoryError if jets0 has a wrong shape or is not finite, or the duration is not positive.
    """
    check_reference(target)
    jets0 = checks.finite("jets0", jets0, TrajectoryError)
    if jets0.shape != (JETS, target.n):
        raise TrajectoryError(f"jets0 has shape {jets0.shape}; expected ({JETS}, {target.n}), value and derivatives")
    t0 = number("t0", t0)
    t1 = t0 + positive("duration", duration)
    while isinstance(target, Transition) and target.transition_end <= t1:
        target = target.target
    segment = PiecewisePolynomial(np.array([t0, t1]), np.stack([jets0, target.jets(t1)]))
    if not segment.finite:
        raise TrajectoryError(f"duration is {duration} s at {t0} s; expected a longer one")
    return Transition(segment, target)


@dataclass(frozen=True, eq=False)
class TimeShifted:
    """`reference` with its time 0 at t0 [s]; created by time_shifted."""

    reference: Reference
    t0: float

    __repr__ = one_line

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.reference.n

    @property
    def end(self) -> float:
        """End [s] of the reference in the shifted time."""
        return self.reference.end + self.t0

    def jets(self, t: ArrayLike) -> Array:
        """Return q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        return self.reference.jets(np.subtract(t, self.t0) if np.ndim(t) else t - self.t0)  # type: ignore[operator]

    def configurations(self, k: int) -> Array:
        """Return k configurations (k, n) [rad] of the reference."""
        return self.reference.configurations(k)

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return bounds of position, velocity and acceleration from t0 to t1 [s]."""
        return self.reference.motion_bounds(t0 - self.t0, t1 - self.t0).delayed(self.t0)


def time_shifted(reference: Reference, t0: float) -> Reference:
    """Return `reference` with its time 0 at t0 [s]. Raises TrajectoryError if t0 is not finite."""
    check_reference(reference)
    t0 = number("t0", t0)
    while isinstance(reference, TimeShifted):
        t0 += reference.t0
        reference = reference.reference
    return TimeShifted(reference, t0) if t0 else reference
