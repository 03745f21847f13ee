# SPDX-License-Identifier: Apache-2.0
"""A reference through points: positions, with or without velocities and accelerations, of class C^4."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import TrajectoryError
from ..numerics import checks
from ..numerics.checks import Array, freeze
from .bounds import Extremes
from .minimum_jerk import least_jerk, without_overshoot
from .piecewise_polynomial import Pieces
from .reference import JETS

SHORTEST = 1e-6  # s, between points


@dataclass(frozen=True, eq=False)
class Spline:
    """The reference through positions (k, n) [rad] at times (k,) [s], increasing: polynomials of degree 9, C^4.

    velocities [rad/s], accelerations [rad/s^2], both (k, n) or None: met at the points. The derivatives that are
    not given have least jerk, made smaller where a piece would overshoot (minimum_jerk); they are zero at an end
    where it starts from rest or comes to rest.
    start: jets (5, n) of a running reference at t = 0, which it begins with; all times are > 0 then. Without,
    it begins at the first point, with the velocity and acceleration given there, and stands there before.
    At the last point it comes to rest and stays: a velocity given there must be zero, an acceleration is not
    looked at. moving_end: velocity and acceleration of the last point are met; after it, it stands all the same.
    Raises TrajectoryError for shapes that do not fit, numbers that are not finite, times that do not increase
    and fewer than two points (one with start).
    """

    times: ArrayLike
    positions: ArrayLike
    velocities: ArrayLike | None = None
    accelerations: ArrayLike | None = None
    start: ArrayLike | None = None
    moving_end: bool = False
    pieces: Pieces = field(init=False, repr=False)

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
            freeze(self, "start", _start(self.start, positions.shape[1]))
        _check_times(times, self.start is not None)
        self._check_end()
        object.__setattr__(self, "pieces", self._made())

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.pieces.n

    @property
    def end(self) -> float:
        """The last time."""
        return float(self.pieces.times[-1])

    def jets(self, t: ArrayLike) -> Array:
        """q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        return self.pieces.jets(t)

    def configurations(self, k: int) -> Array:
        """k configurations (k, n) [rad], evenly in time from the first point (or start) to the last."""
        return self.jets(np.linspace(self.pieces.times[0], self.end, k))[:, 0]

    def extremes(self, t0: float, t1: float) -> Extremes:
        """Bounds of position, velocity and acceleration from t0 to t1 [s]."""
        return self.pieces.extremes(t0, t1)

    def hull(self, t0: float, t1: float) -> tuple[Array, Array]:
        """lower, upper (3, n) that position, velocity and acceleration do not leave from t0 to t1 [s]; may be wide."""
        return self.pieces.hull(t0, t1)

    def _check_end(self) -> None:
        if self.velocities is None or self.moving_end:
            return
        last = np.asarray(self.velocities)[-1]
        if np.any(last):
            raise TrajectoryError(f"velocities ends with {last.tolist()}; expected zeros at the last point")

    def _made(self) -> Pieces:
        """The pieces through the points with all their derivatives chosen."""
        times, (jets, free) = np.asarray(self.times), self._given()
        if self.start is not None:
            times = np.insert(times, 0, 0.0)
            jets = np.concatenate([np.asarray(self.start)[None], jets])
            free = np.concatenate([np.zeros((1, JETS), dtype=bool), free])
        try:
            with np.errstate(all="ignore"):
                jets = without_overshoot(times, least_jerk(times, jets, free), free) if free.any() else jets
                pieces = Pieces(times, jets)
        except np.linalg.LinAlgError:  # the system is not positive definite to rounding
            pieces = None
        if pieces is None or not pieces.finite:
            raise TrajectoryError("positions and times lead to numbers that are not finite; expected smaller ones")
        return pieces

    def _given(self) -> tuple[Array, NDArray[np.bool_]]:
        """Jets (k, 5, n) of the points with zeros where none are given, and which of them are free (k, 5)."""
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
    """`value` as (k, n)."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise TrajectoryError(f"{name} is {value!r}; expected numbers (k, n)") from None
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


def _start(value: ArrayLike, n: int) -> Array:
    array = checks.finite("start", value, TrajectoryError)
    if array.shape != (JETS, n):
        raise TrajectoryError(f"start has shape {array.shape}; expected ({JETS}, {n}), value and four derivatives")
    return array


def _check_times(times: Array, starts: bool) -> None:
    if len(times) < 2 and not starts:
        raise TrajectoryError("times has 1 point; expected at least 2, or 1 with start")
    if starts and times[0] < SHORTEST:
        raise TrajectoryError(f"times begins with {times[0]} s; expected more than 0, where start is")
    stalls = np.flatnonzero(np.diff(times) < SHORTEST)
    if len(stalls):
        i = int(stalls[0])
        first, second = (f"{times[j]} s at point {j}" for j in (i, i + 1))
        raise TrajectoryError(f"times goes from {first} to {second}; expected an increase of at least {SHORTEST:g} s")
