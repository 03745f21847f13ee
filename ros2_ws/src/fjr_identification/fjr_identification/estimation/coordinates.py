# SPDX-License-Identifier: Apache-2.0
"""The vector z in which is optimised: free parameters in their coordinates, with the prior of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import LOG, NONNEGATIVE

from .elastic_arm import DYNAMIC, ElasticArm
from .parameters import KINDS


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Free parameters (name, index) in the order of KINDS: those of the equations of motion, delays, skews.

    values: of all parameters, by name. mean, width (p,): normal prior of z.
    """

    free: tuple[tuple[str, int], ...]
    values: Mapping[str, Array]
    mean: Array
    width: Array

    @classmethod
    def of(
        cls, free: Sequence[tuple[str, int]], values: Mapping[str, Array], widths: Mapping[str, Array]
    ) -> Coordinates:
        """Return coordinates with the values as mean of the prior and the widths by name."""
        mean = [_coordinate(name, values[name][i]) for name, i in free]
        return cls(tuple(free), values, np.array(mean), np.array([widths[name][i] for name, i in free], dtype=float))

    @property
    def nonnegative(self) -> Array:
        """Return which entries (p,) of z are not negative."""
        return np.array([KINDS[name].coordinate == NONNEGATIVE for name, _ in self.free], dtype=bool)

    def without(self, dropped: Sequence[int]) -> Coordinates:
        """Return the coordinates without some entries, which keep their values."""
        kept = [k for k in range(len(self.free)) if k not in dropped]
        return replace(self, free=tuple(self.free[k] for k in kept), mean=self.mean[kept], width=self.width[kept])

    def parameters(self, z: Array) -> dict[str, Array]:
        """Return all parameters by name at z (p,)."""
        found = {name: np.array(value, dtype=float) for name, value in self.values.items()}
        for (name, i), value in zip(self.free, z, strict=True):
            found[name][i] = np.exp(value) if KINDS[name].coordinate == LOG else value
        return found

    def scale(self, z: Array) -> Array:
        """Return d parameter / d z (p,) at z."""
        logarithmic = np.array([KINDS[name].coordinate == LOG for name, _ in self.free], dtype=bool)
        return np.where(logarithmic, np.exp(np.where(logarithmic, z, 0.0)), 1.0)

    def of_values(self, values: Mapping[str, Array]) -> Array:
        """Return z (p,) of parameters by name."""
        return np.array([_coordinate(name, values[name][i]) for name, i in self.free])

    def entries(self, names: Sequence[str]) -> tuple[int, ...]:
        """Return the entries of z with these names."""
        return tuple(k for k, (name, _) in enumerate(self.free) if name in names)

    @property
    def dynamic(self) -> tuple[tuple[str, int], ...]:
        """Return the free parameters of the equations of motion."""
        return tuple(each for each in self.free if each[0] in DYNAMIC)

    @property
    def delays(self) -> tuple[int, ...]:
        """Return the joints whose effort delay is free."""
        return tuple(i for name, i in self.free if name == "effort_delay")


def packed(arm: ElasticArm, parameters: Mapping[str, Array]) -> Array:
    """Return the parameters of the arm as one vector."""
    return np.concatenate([np.atleast_1d(parameters[name]) for name in arm.layout.sizes])


def _coordinate(name: str, value: float) -> float:
    return float(np.log(value) if KINDS[name].coordinate == LOG else value)
