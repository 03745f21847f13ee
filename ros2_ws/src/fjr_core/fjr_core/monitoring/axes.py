# SPDX-License-Identifier: Apache-2.0
"""Names, units and tolerances of the joints in a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import StateError
from ..law.vdpbc import TrackingLaw
from ..numerics.checks import Array, vector
from .thresholds import TOLERANCE

LARGE = 0.1  # rad, m; smaller errors are written in thousandths


@dataclass(frozen=True)
class Axes:
    """Names, units and tolerances of the joints in a diagnosis.

    names, units: of n joints; a unit is "rad" or "m". tolerance (n,) [rad, m]: tracking error up to which a violation
    of the decay of V is a degradation. Raises StateError for numbers that do not fit.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    tolerance: Array

    def __post_init__(self) -> None:
        tolerance = vector("tolerance", self.tolerance, len(self.names), StateError)
        if not (tolerance > 0).all():
            raise StateError(f"tolerance is {tolerance.tolist()}; expected positive numbers")
        if len(self.units) != len(self.names):
            raise StateError(f"units are {self.units}; expected one for each of {len(self.names)} joints")
        object.__setattr__(self, "tolerance", tolerance)

    @classmethod
    def plain(cls, n: int) -> Axes:
        """Return n revolute joints called joint1 .. jointn with the default tolerance."""
        return cls(tuple(f"joint{j + 1}" for j in range(n)), ("rad",) * n, np.full(n, TOLERANCE))

    def storage(self, law: TrackingLaw) -> float:
        """Return V = e' Pi_l e / 2 [J] of links at rest whose error e is the tolerance, at least TOLERANCE."""
        e = np.maximum(self.tolerance, TOLERANCE)
        return float(e @ law.gains.Pi_l @ e) / 2

    def largest(self, errors: Array) -> str:
        """Format the largest of errors (n,) relative to its tolerance: "0.14 mrad at joint2"."""
        j = int(np.argmax(errors / self.tolerance))
        size = f"{errors[j]:.2g} " if errors[j] >= LARGE else f"{1e3 * errors[j]:.2g} m"
        return f"{size}{self.units[j]} at {self.names[j]}"
