# SPDX-License-Identifier: Apache-2.0
"""References made of sines: one per joint, or a sum of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics import checks
from ..numerics.checks import Array, freeze
from .bounds import ROWS, Extremes
from .reference import JETS

_SIDES = np.array([0, 1, 0, 1, 0])  # sine or cosine in each of the five


@dataclass(frozen=True, eq=False)
class Sine:
    """q_ld(t) = offset + amplitude sin(frequency t + phase), joint by joint.

    amplitude and offset [rad], frequency (angular) [rad/s], phase [rad]: scalars or vectors (n,); the
    longest gives n. Raises TrajectoryError when the lengths differ or a value is not finite.
    """

    amplitude: ArrayLike
    frequency: ArrayLike
    offset: ArrayLike = 0.0
    phase: ArrayLike = 0.0

    def __post_init__(self) -> None:
        names = ("amplitude", "frequency", "offset", "phase")
        arrays = [checks.finite(name, getattr(self, name), TrajectoryError) for name in names]
        n = max(array.size for array in arrays)
        for name, array in zip(names, arrays, strict=True):
            array = checks.vector(name, array, n, TrajectoryError)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(np.size(self.amplitude))

    @property
    def end(self) -> float:
        """Infinite."""
        return np.inf

    def jets(self, t: ArrayLike) -> Array:
        """q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        w, phase, offset = self._line
        angle = w * t if isinstance(t, float) else np.multiply.outer(np.asarray(t, dtype=float), w)
        angle += phase
        sides = np.empty((*angle.shape[:-1], 2, len(w)))
        np.sin(angle, out=sides[..., 0, :])
        np.cos(angle, out=sides[..., 1, :])
        sides *= self.amplitude
        jets = sides.take(_SIDES, axis=-2)
        jets *= self._factors
        jets[..., 0, :] += offset
        return jets

    @cached_property
    def _line(self) -> tuple[Array, Array, Array]:
        return np.asarray(self.frequency), np.asarray(self.phase), np.asarray(self.offset)

    @cached_property
    def _factors(self) -> Array:
        """The powers of the frequency (5, n) that the derivatives have before sine or cosine."""
        w = np.asarray(self.frequency)
        return np.stack([np.ones_like(w), w, -(w**2), -(w**3), w**4])

    def configurations(self, k: int) -> Array:
        """k configurations (k, n) [rad]: joints of one frequency together, others with every phase to each other."""
        angles = phases(k, np.asarray(self.frequency)) + np.asarray(self.phase)
        return np.asarray(self.offset) + np.asarray(self.amplitude) * np.sin(angles)

    def extremes(self, t0: float, t1: float) -> Extremes:
        """Bounds of position, velocity and acceleration from t0 to t1 [s], exactly."""
        a, w = np.asarray(self.amplitude), np.asarray(self.frequency)
        rows = [_swing(a * w**row, w, np.asarray(self.phase) + row * np.pi / 2, t0, t1) for row in range(ROWS)]
        lower, upper, lower_at, upper_at = (np.array(values) for values in zip(*rows, strict=True))
        lower[0] += self.offset
        upper[0] += self.offset
        return Extremes(lower, upper, lower_at, upper_at)


@dataclass(frozen=True, eq=False)
class MultiSine:
    """q_ld(t) = offset + sum over m of amplitude sin(frequency t + phase), joint by joint.

    amplitude [rad], frequency (angular) [rad/s], phase [rad]: (m, n), or scalars for all; offset [rad]: scalar or
    (n,). Raises TrajectoryError when shapes differ or a value is not finite.
    """

    amplitude: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike = 0.0
    offset: ArrayLike = 0.0

    def __post_init__(self) -> None:
        amplitude = checks.finite("amplitude", self.amplitude, TrajectoryError)
        if amplitude.ndim != 2 or not amplitude.size:
            raise TrajectoryError(f"amplitude has shape {amplitude.shape}; expected (m, n), a row for each sine")
        freeze(self, "amplitude", amplitude)
        for name in ("frequency", "phase"):
            freeze(self, name, _table(name, getattr(self, name), amplitude.shape))
        freeze(self, "offset", checks.vector("offset", self.offset, amplitude.shape[1], TrajectoryError))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(np.size(self.offset))

    @property
    def end(self) -> float:
        """Infinite."""
        return np.inf

    @cached_property
    def _of_sine(self) -> Array:
        a, w = np.asarray(self.amplitude), np.asarray(self.frequency)
        return np.stack([a, -a * w**2, a * w**4])

    @cached_property
    def _of_cosine(self) -> Array:
        a, w = np.asarray(self.amplitude), np.asarray(self.frequency)
        return np.stack([a * w, -a * w**3])

    def jets(self, t: ArrayLike) -> Array:
        """q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        angle = np.multiply.outer(t, self.frequency) + self.phase
        jets = np.empty((*np.shape(t), JETS, self.n))
        jets[..., 0::2, :] = (self._of_sine * np.sin(angle)[..., None, :, :]).sum(axis=-2)
        jets[..., 1::2, :] = (self._of_cosine * np.cos(angle)[..., None, :, :]).sum(axis=-2)
        jets[..., 0, :] += np.asarray(self.offset)
        return jets

    def configurations(self, k: int) -> Array:
        """k configurations (k, n) [rad]; see Sine.configurations."""
        angles = phases(k, np.asarray(self.frequency)) + np.asarray(self.phase)
        return np.asarray(self.offset) + (np.asarray(self.amplitude) * np.sin(angles)).sum(axis=1)

    def extremes(self, t0: float, t1: float) -> Extremes:
        """Sums of the sines' own bounds from t0 to t1 [s]: those of one sine exactly, those of more at most."""
        rows = zip(np.asarray(self.amplitude), np.asarray(self.frequency), np.asarray(self.phase), strict=True)
        each = [Sine(a, w, 0.0, p).extremes(t0, t1) for a, w, p in rows]
        lower, upper = (np.sum([getattr(e, side) for e in each], axis=0) for side in ("lower", "upper"))
        shift = np.zeros((ROWS, self.n))
        shift[0] = self.offset
        never = np.full_like(shift, np.nan)
        at = (each[0].lower_at, each[0].upper_at) if len(each) == 1 else (never, never)
        return Extremes(lower + shift, upper + shift, *at)


def _table(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = checks.finite(name, value, TrajectoryError)
    if array.shape not in ((), shape):
        raise TrajectoryError(f"{name} has shape {array.shape}; expected a scalar or that of amplitude, {shape}")
    return np.array(np.broadcast_to(array, shape))


def phases(k: int, frequency: Array) -> Array:
    """k angles (k, *frequency.shape) [rad] that the sines of these frequencies take in the long run.

    Sines of one frequency move together; those of different ones sooner or later take every phase to each other.
    """
    frequencies, place = np.unique(frequency, return_inverse=True)
    turns = _turns(k, len(frequencies)) * (frequencies != 0)
    return 2 * np.pi * turns[:, place.reshape(frequency.shape)]


def _turns(k: int, m: int) -> Array:
    """k points (k, m) of the m-dimensional torus, in turns: evenly along the first, by Roberts' sequence in all."""
    ratio = 2.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / m)
    steps = np.append(1.0 / k, ratio ** -np.arange(1.0, m))
    return np.asarray(np.outer(np.arange(k), steps) % 1.0)


def _swing(a: Array, w: Array, phase: Array, t0: float, t1: float) -> tuple[Array, Array, Array, Array]:
    """lower, upper, lower_at, upper_at (n,) of a sin(w t + phase) from t0 to t1 [s]."""
    edges = np.array([t0, t1 if np.isfinite(t1) else t0])[:, None] + np.zeros_like(a)
    first = [_first(side * np.sign(a) * np.sign(w), np.abs(w), np.sign(w) * phase, t0) for side in (-1.0, 1.0)]
    values = a * np.sin(w * edges + phase)
    low, high, each = values.argmin(axis=0), values.argmax(axis=0), np.arange(len(a))
    lower, upper = values[low, each], values[high, each]
    reaches = [(at <= t1) & (a != 0) & (w != 0) for at in first]
    return (
        np.where(reaches[0], -np.abs(a), lower),
        np.where(reaches[1], np.abs(a), upper),
        np.where(reaches[0], first[0], edges[low, each]),
        np.where(reaches[1], first[1], edges[high, each]),
    )


def _first(side: Array, w: Array, phase: Array, t0: float) -> Array:
    """The first time from t0 on when sin(w t + phase) is `side` (1 or -1), w > 0; infinite for w = 0."""
    angle = (side * np.pi / 2 - phase - w * t0) % (2 * np.pi)
    return t0 + np.divide(angle, w, out=np.full_like(w, np.inf), where=w > 0)
