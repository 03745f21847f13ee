# SPDX-License-Identifier: Apache-2.0
"""Sinusoidal references: one sine per joint and a sum of sines."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics import checks
from ..numerics.checks import Array, freeze
from ..numerics.one_line import one_line
from ..numerics.parameter_field import ROWS as TABLE
from ..numerics.parameter_field import VECTOR
from .reference import MotionBounds, Reference, motion_bounds_on, motion_field, offset_field

MOST_CYCLES = 1000
"""Cycles of the fastest sine in a common period of several, up to which their bounds are exact."""
POINTS_PER_CYCLE = 8  # of the highest frequency, between which extrema are searched
_ROUNDING = 1e-9  # relative to the highest frequency

_SIDES = np.array([0, 1, 0, 1, 0])  # sine (0) or cosine (1) in each of the five jets
_of_rows = partial(motion_field, name="multi_sine.", shape=TABLE)


class Sines(Reference):
    """Base of Sine and MultiSine: offset + the sum over m rows of amplitude sin(frequency t + phase)."""

    amplitude: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike
    offset: ArrayLike

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(np.size(self.offset))

    @cached_property
    def rows(self) -> tuple[Array, Array, Array]:
        """Amplitude, frequency and phase, (m, n) each."""
        amplitude, frequency, phase = map(np.atleast_2d, (self.amplitude, self.frequency, self.phase))
        return amplitude, frequency, phase

    @cached_property
    def _factors(self) -> Array:
        """Factors (5, m, n) of sine or cosine in the five jets: signed powers of the frequency."""
        w = self.rows[1]
        return np.stack([np.ones_like(w), w, -(w**2), -(w**3), w**4])

    def jets(self, t: ArrayLike) -> Array:
        """Return q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        amplitude, frequency, phase = self.rows
        angle = np.multiply.outer(np.asarray(t, dtype=float), frequency) + phase
        sides = amplitude * np.stack([np.sin(angle), np.cos(angle)], axis=-3)
        jets = (sides.take(_SIDES, axis=-3) * self._factors).sum(axis=-2)
        jets[..., 0, :] += np.asarray(self.offset)
        return np.asarray(jets)

    @cached_property
    def period(self) -> float | None:
        """Common period [s] of several rows; None without one of at most MOST_CYCLES cycles, and for one row."""
        _, frequency, _ = self.rows
        return common_period(frequency) if len(frequency) > 1 else None

    def configurations(self, k: int) -> Array:
        """Return k configurations (k, n) [rad], over the common period if there is one, else over all relative phases.

        Sines of equal frequency share their angle; the angles of different frequencies fill the torus.
        """
        if self.period is not None:
            return np.asarray(self.jets(self.period * _turns(k, 2)[:, 1])[:, 0])
        amplitude, frequency, phase = self.rows
        frequencies, place = np.unique(frequency, return_inverse=True)
        turns = _turns(k, len(frequencies)) * (frequencies != 0)
        angles = 2 * np.pi * turns[:, place.reshape(frequency.shape)] + phase
        return np.asarray(self.offset) + (amplitude * np.sin(angles)).sum(axis=1)

    def motion_bounds(self, t0: float, t1: float) -> MotionBounds:
        """Return bounds of position, velocity and acceleration from t0 to t1 [s].

        They are exact for one row and for rows with a common period. For other rows they are the sums of the bounds of
        the rows, which is conservative, and their times are NaN.
        """
        _, frequency, _ = self.rows
        if len(frequency) > 1 and self.period is None:
            each = [Sine(a, w, phase=p).motion_bounds(t0, t1) for a, w, p in zip(*self.rows, strict=True)]
            bounds = np.sum(each, axis=0)
            bounds[:2, 0] += np.asarray(self.offset)
            bounds[2:] = np.nan
            return MotionBounds(*bounds)
        grids = [np.array([t0, min(t1, t0 + 1.0)])]
        for w in np.unique(np.abs(frequency[frequency != 0])):  # each over the common period, or its own
            length = min(t1 - t0, self.period or 2 * np.pi / w)
            parts = POINTS_PER_CYCLE * (int(length * w / (2 * np.pi)) + 1)
            grids.append(t0 + length * np.arange(parts + 1) / parts)
        return motion_bounds_on(self.jets, np.unique(np.concatenate(grids)))


@dataclass(frozen=True, eq=False)
class Sine(Sines):
    """Sine per joint: q_ld(t) = offset + amplitude sin(frequency t + phase).

    amplitude and offset [rad], angular frequency [rad/s], phase [rad]: scalars or vectors (n,); the longest gives n.
    Raises TrajectoryError for different lengths or a non-finite value.
    """

    amplitude: ArrayLike = motion_field(MISSING, "Amplitude of the sine", "rad", shape=VECTOR)
    frequency: ArrayLike = motion_field(MISSING, "Angular frequency of the sine", "rad/s", minimum=0.0, shape=VECTOR)
    offset: ArrayLike = offset_field(0.0)
    phase: ArrayLike = motion_field(0.0, "Phase of the sine", "rad", shape=VECTOR)

    __repr__ = one_line

    def __post_init__(self) -> None:
        names = ("amplitude", "frequency", "offset", "phase")
        arrays = [checks.finite(name, getattr(self, name), TrajectoryError) for name in names]
        n = max(array.size for array in arrays)
        for name, array in zip(names, arrays, strict=True):
            freeze(self, name, checks.vector(name, array, n, TrajectoryError))


@dataclass(frozen=True, eq=False)
class MultiSine(Sines):
    """Sum of m sines per joint: q_ld(t) = offset + sum_m amplitude sin(frequency t + phase).

    amplitude [rad], angular frequency [rad/s], phase [rad]: (m, n), or scalars for all; offset [rad]: scalar or (n,).
    Raises TrajectoryError for different shapes or a non-finite value.
    """

    amplitude: ArrayLike = _of_rows(MISSING, "Amplitudes of the sines", "rad")
    frequency: ArrayLike = _of_rows(MISSING, "Angular frequencies of the sines", "rad/s", minimum=0.0)
    phase: ArrayLike = _of_rows(0.0, "Phases of the sines", "rad")
    offset: ArrayLike = offset_field(0.0)

    __repr__ = one_line

    def __post_init__(self) -> None:
        amplitude = checks.finite("amplitude", self.amplitude, TrajectoryError)
        if amplitude.ndim != 2 or not amplitude.size:
            raise TrajectoryError(f"amplitude has shape {amplitude.shape}; expected (m, n), a row for each sine")
        freeze(self, "amplitude", amplitude)
        for name in ("frequency", "phase"):
            array = checks.finite(name, getattr(self, name), TrajectoryError)
            freeze(self, name, checks.filled(name, array, amplitude.shape, TrajectoryError))
        freeze(self, "offset", checks.vector("offset", self.offset, amplitude.shape[1], TrajectoryError))


def common_period(frequency: Array) -> float | None:
    """Return the common period [s] of angular frequencies [rad/s]; None if it has more than MOST_CYCLES cycles.

    The base frequency is their greatest common divisor, by Euclid's algorithm up to rounding.
    """
    moving = np.unique(np.abs(frequency[frequency != 0]))
    if not len(moving):
        return None
    base, highest = float(moving[0]), float(moving[-1])
    for w in moving[1:].tolist():
        larger, smaller = w, base
        while smaller > _ROUNDING * highest:
            larger, smaller = smaller, abs(larger - smaller * round(larger / smaller))
        base = larger
    return 2 * np.pi / base if highest / base <= MOST_CYCLES else None


def _turns(k: int, m: int) -> Array:
    """Return k points (k, m) on the m-dimensional torus, in turns: equally spaced in the first, Roberts' sequence."""
    ratio = 2.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / m)
    steps = np.append(1.0 / k, ratio ** -np.arange(1.0, m))
    return np.asarray(np.outer(np.arange(k), steps) % 1.0)
