# SPDX-License-Identifier: Apache-2.0
"""Reference along the samples of a motion: smoothed where they are dense, interpolated where they are waypoints."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics.checks import Array, floats, freeze
from ..numerics.one_line import joints, span
from .minimum_jerk import minimum_jerk
from .piecewise_polynomial import PiecewisePolynomial, PolynomialReference
from .reference import JETS
from .smoothing import least_squares_fit
from .spline import Spline


@dataclass(frozen=True, eq=False)
class SampledMotion(PolynomialReference):
    """Reference of class C^4 from samples: positions (k, n) [rad] at increasing times (k,) [s], the first at 0.

    Dense samples are smoothed by the least-squares spline whose largest deviation is at most `tolerance`, one number
    for all joints or (n,) [rad, m]. If there is none, or with tolerance 0 of a joint, the samples are waypoints: a
    Spline interpolates them, and the velocities (k, n) [rad/s] if given. A motion that starts at speed is at that speed
    at t = 0. A motion that ends at speed is continued until it is at rest, with about the largest acceleration of the
    samples.
    Raises TrajectoryError as Spline does, and for a tolerance that is negative, NaN or of another length.
    """

    times: ArrayLike
    positions: ArrayLike
    tolerance: ArrayLike
    velocities: ArrayLike | None = None
    pieces: PiecewisePolynomial = field(init=False, repr=False)
    deviation: Array = field(init=False, repr=False)
    """Largest distance (n,) [rad] of the reference from the samples."""
    smoothed: bool = field(init=False)

    def __repr__(self) -> str:
        kind = f"smoothed within {self.deviation.max():.2g}" if self.smoothed else "interpolated"
        samples = f"{np.size(self.times)} samples {kind}"
        return f"SampledMotion({joints(self.n)}, {samples}, {span(self.pieces.times)})"

    def __post_init__(self) -> None:
        waypoints = Spline(self.times, self.positions, self.velocities, moving_end=self.velocities is not None)
        for name in ("times", "positions", "velocities"):
            if getattr(waypoints, name) is not None:
                freeze(self, name, np.array(getattr(waypoints, name)))
        t, q = np.asarray(self.times), np.asarray(self.positions)
        tolerance = _tolerance(self.tolerance, q.shape[1])
        freeze(self, "tolerance", tolerance)
        fit = least_squares_fit(t, q, tolerance) if np.all(tolerance > 0) else None
        if fit is None:
            knots, jets = waypoints.pieces.times, waypoints.pieces.knots
        else:
            knots, jets = fit.times, fit.jets
        object.__setattr__(self, "pieces", PiecewisePolynomial(*_brought_to_rest(knots, jets)))
        object.__setattr__(self, "smoothed", fit is not None)
        freeze(self, "deviation", np.zeros(q.shape[1]) if fit is None else fit.deviation)

    @property
    def initial_velocity(self) -> Array:
        """Velocity (n,) [rad/s] at t = 0."""
        return self.pieces.knots[0, 1]

    @cached_property
    def velocity_error(self) -> Array:
        """Largest difference (n,) [rad/s] from the given velocities; zero if there are none."""
        if self.velocities is None:
            return np.zeros(self.n)
        return np.asarray(np.abs(self.jets(self.times)[:, 1] - np.asarray(self.velocities)).max(axis=0))


def _tolerance(given: ArrayLike, n: int) -> Array:
    """Return the tolerance of each joint (n,); raise TrajectoryError."""
    array = floats("tolerance", given, TrajectoryError)
    if array.shape not in ((), (1,), (n,)):
        expected = "1" if n == 1 else f"1 or {n}, one per joint"
        raise TrajectoryError(f"tolerance has {array.size} entries; expected {expected}")
    if not np.all(array >= 0):
        raise TrajectoryError(f"tolerance is {array.tolist()}; expected 0 or more")
    return np.array(np.broadcast_to(array, n))


def _brought_to_rest(times: Array, jets: Array) -> tuple[Array, Array]:
    """Append a knot at rest after times (k,) [s] and jets (k, 5, n) that end in motion."""
    last = jets[-1]
    if not last[1:].any():
        return times, jets
    speed, acceleration = np.abs(last[1]), np.abs(jets[:, 2]).max(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        duration = np.nanmax(np.append(3 * speed / acceleration, np.diff(times)[-1]))
    duration = float(np.clip(duration, np.diff(times)[-1], times[-1] - times[0]))
    free = np.zeros((2, JETS), dtype=bool)
    free[1, 0] = True  # the position at rest, which minimises the jerk
    ends = minimum_jerk(np.array([0.0, duration]), np.stack([last, np.zeros_like(last)]), free)
    return np.append(times, times[-1] + duration), np.concatenate([jets, ends[1:]])
