# SPDX-License-Identifier: Apache-2.0
"""References of class C^4: value and four exact derivatives at every time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from . import checks
from .checks import Array
from .errors import TrajectoryError
from .flow import REFERENCE_DERIVATIVES

JETS = REFERENCE_DERIVATIVES + 1


class Reference(Protocol):
    """What the law needs of a reference."""

    @property
    def n(self) -> int:
        """Number of joints."""

    def jets(self, t: ArrayLike) -> Array:
        """q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""


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

    def jets(self, t: ArrayLike) -> Array:
        """q_ld .. d4q_ld at time t [s]: (5, n) for a scalar t, (k, 5, n) for t (k,)."""
        w = np.asarray(self.frequency)
        angle = np.multiply.outer(np.asarray(t, dtype=float), w) + self.phase
        s, c = self.amplitude * np.sin(angle), self.amplitude * np.cos(angle)
        return np.stack([self.offset + s, w * c, -(w**2) * s, -(w**3) * c, w**4 * s], axis=-2)
