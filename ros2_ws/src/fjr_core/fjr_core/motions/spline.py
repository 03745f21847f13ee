# SPDX-License-Identifier: Apache-2.0
"""Spline reference of class C^4 through positions, with optional velocities and accelerations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import TrajectoryError
from ..numerics import checks
from ..numerics.checks import Array, freeze
from ..numerics.one_line import joints, span
from .piecewise_polynomial import PolynomialReference, minimum_jerk, without_overshoot
from .reference import JETS

SHORTEST = 1e-6  # s, smallest interval between points
FAR, STANDSTILL = 2.0, 1.0  # s; a motion whose next point is more than FAR ahead comes to a standstill first


@dataclass(frozen=True, eq=False)
class Spline(PolynomialReference):
    """Reference through positions (k, n) [rad] at increasing times (k,) [s]: polynomials of degree 9, class C^4.

    velocities [rad/s], accelerations [rad/s^2]: (k, n) or None, interpolated at the points. Derivatives that are not
    given minimise the jerk and are reduced where a segment would overshoot (piecewise_polynomial.py); they are zero at
    an end with zero velocity.
    start: jets (5, n) of the active reference at t = 0, from which the spline starts; all times must be > 0. If start
    moves and the first point is more than FAR ahead, the spline comes to a standstill within STANDSTILL, over half the
    distance of constant velocity: a single polynomial would swing out by jets times powers of its duration. Without
    start, the spline starts at the first point with the velocity and acceleration given there; before, it is constant.
    At the last point the spline stops: a velocity given there must be zero, an acceleration is ignored.
    moving_end: interpolate velocity and acceleration of the last point; after it the reference is constant.
    Raises TrajectoryError for inconsistent shapes, non-finite numbers, times that do not increase, or fewer than two
    points (one with start).
    """

    times: ArrayLike
    positions: ArrayLike
    velocities: ArrayLike | None = None
    accelerations: ArrayLike | None = None
    start: ArrayLike | None = None
    moving_end: bool = False

    def __repr__(self) -> str:
        return f"Spline({joints(self.n)}, {np.size(self.times)} points, {span(self.knot_times)})"

    def __post_init__(self) -> None:
        positions = _points("positions", self.positions)
        times = checks.finite("times", self.times, TrajectoryError)
        if times.shape != positions.shape[:1]:
            raise TrajectoryError(f"times has shape {times.shape}; expected {positions.shape[:1]}, one per point")
        freeze(self, "times", times)
        freeze(self, "positions", positions)
        for name in ("velocities", "accelerations"):
            if getattr(self, name) is not None:
                freeze(self, name, _points(name, getattr(self, name), positions.shape))
        if self.start is not None:
            start, shape = checks.finite("start", self.start, TrajectoryError), (JETS, positions.shape[1])
            if start.shape != shape:
                raise TrajectoryError(f"start has shape {start.shape}; expected {shape}, value and four derivatives")
            freeze(self, "start", start)
        _check_times(times, self.start is not None)
        if self.velocities is not None and not self.moving_end and np.any(last := np.asarray(self.velocities)[-1]):
            raise TrajectoryError(f"velocities ends with {last.tolist()}; expected zeros at the last point")
        self._interpolate()

    def _interpolate(self) -> None:
        """Set the knots: the points, and those before them, with the free derivatives chosen."""
        times, (jets, free) = np.asarray(self.times), self._given()
        if self.start is not None:
            begin, before = np.asarray(self.start)[None], [0.0]
            if times[0] > FAR and np.any(begin[:, 1:]):
                begin, before = np.concatenate([begin, np.zeros_like(begin)]), [0.0, STANDSTILL]
                begin[1, 0] = begin[0, 0] + begin[0, 1] * STANDSTILL / 2
            times, jets = np.concatenate([before, times]), np.concatenate([begin, jets])
            free = np.concatenate([np.zeros((len(before), JETS), dtype=bool), free])
        try:
            with np.errstate(all="ignore"):
                jets = without_overshoot(times, minimum_jerk(times, jets, free), free) if free.any() else jets
        except np.linalg.LinAlgError:  # the system is not positive definite to rounding
            jets = np.full_like(jets, np.nan)
        self.set_knots(times, jets)
        if not self.finite:
            raise TrajectoryError("positions and times lead to numbers that are not finite; expected smaller ones")

    def _given(self) -> tuple[Array, NDArray[np.bool_]]:
        """Return the jets (k, 5, n) of the points, zero where not given, and the mask (k, 5) of the free ones."""
        rows = (self.positions, self.velocities, self.accelerations)
        k, n = np.shape(self.positions)
        jets, free = np.zeros((k, JETS, n)), np.ones((k, JETS), dtype=bool)
        for order, row in enumerate(rows):
            if row is not None:
                jets[:, order], free[:, order] = row, False
        if not self.moving_end:
            jets[-1, 1:] = 0.0
        for end in (0, -1):
            if not np.any(jets[end, 1:]) and not (end == 0 and self.start is not None):
                free[end] = False
        return jets, free


def _points(name: str, value: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
    """Return `value` as finite numbers (k, n); raise TrajectoryError."""
    array = checks.floats(name, value, TrajectoryError, " (k, n)")
    if shape is None and (array.ndim != 2 or not array.size):
        raise TrajectoryError(f"{name} has shape {array.shape}; expected (k, n), a row for each point")
    if shape is not None and array.shape != shape:
        raise TrajectoryError(f"{name} has shape {array.shape}; expected that of positions, {shape}")
    wrong = np.argwhere(~np.isfinite(array))
    if len(wrong):
        point, joint = wrong[0]
        raise TrajectoryError(
            f"{name} holds {array[point, joint]} at point {point}, joint {joint}; expected finite numbers"
        )
    return array


def _check_times(times: Array, starts: bool) -> None:
    if len(times) < 2 and not starts:
        raise TrajectoryError("times has 1 point; expected at least 2, or 1 with start")
    if starts and times[0] < SHORTEST:
        raise TrajectoryError(f"times begins with {times[0]} s; expected more than 0, the time of start")
    stalls = np.flatnonzero(np.diff(times) < SHORTEST)
    if len(stalls):
        i = int(stalls[0])
        first, second = (f"{times[j]} s at point {j}" for j in (i, i + 1))
        raise TrajectoryError(f"times goes from {first} to {second}; expected an increase of at least {SHORTEST:g} s")
