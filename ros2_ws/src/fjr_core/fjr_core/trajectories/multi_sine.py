# SPDX-License-Identifier: Apache-2.0
"""A reference that is a sum of sines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from ..numerics import checks
from ..numerics.checks import Array
from ..numerics.reference_checks import freeze
from .bounds import ROWS, Extremes
from .reference import JETS, Sine, phases


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
