# SPDX-License-Identifier: Apache-2.0
"""Pieces of a periodic reference, one sample long each: centres, transitions, and radii of the tube."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.law.linearized import Indices
from fjr_core.numerics.checks import Array
from fjr_core.numerics.intervals import Interval

from ..verification.interval_matrices import ABOVE

CHUNK = 2048
"""Pieces that are verified together."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of the reference: piece j holds the samples at times from j h to (j + 1) h.

    index (k,). centre (k, m): centre of the tube. C (k, m, m): Jacobian there at (j + 1) h. rate (k, m): the field.
    """

    index: Indices
    centre: Array
    C: Interval
    rate: Interval

    def at(self, chosen: Indices) -> Pieces:
        """Return these of the pieces."""
        return Pieces(self.index[chosen], self.centre[chosen], self.C[chosen], self.rate[chosen])


def joined(parts: Sequence[Pieces]) -> Pieces:
    """Return the pieces of all parts."""
    C, rate = ([getattr(part, name) for part in parts] for name in ("C", "rate"))
    return Pieces(
        np.concatenate([part.index for part in parts]),
        np.concatenate([part.centre for part in parts]),
        *(Interval(np.concatenate([x.mid for x in each]), np.concatenate([x.rad for x in each])) for each in (C, rate)),
    )


def chunks(pieces: Indices) -> list[Indices]:
    """Split pieces into parts of at most CHUNK."""
    return np.array_split(pieces, -(-len(pieces) // CHUNK))


def number_of_pieces(period: float, h: float) -> int:
    """Return the number N of pieces of a sample period h [s] that cover a period [s] in spite of rounding."""
    return int(np.ceil(period / h * (1 + 1e-12)))


def transitions_of(pieces: int) -> tuple[Indices, Indices]:
    """Return the pieces before and after each of N + 1 transitions.

    A period of T = (N - 1) h + rest has N or N - 1 samples: piece 0 follows piece N - 1, or N - 2.
    """
    before = np.append(np.arange(pieces), pieces - 2)
    after = np.append(np.arange(1, pieces), [0, 0])
    return before, after


def ultimate_radius(rho: Array, displacement: Array) -> float:
    """Return the radius of a ball that every solution enters; infinite if some factor is not below 1."""
    return float(ABOVE * np.max(displacement / (1 - rho))) if np.all(rho < 1) else float(np.inf)


def final_radii(rho: Array, displacement: Array) -> Array:
    """Return radii (N,) of the balls that every solution is in after a while: r_j+1 = rho_j r_j + d_j."""
    r, radii = ultimate_radius(rho, displacement), np.empty(len(rho) - 1)
    for _ in range(2):
        for j in range(len(radii)):
            radii[j] = r
            r = float(ABOVE * (rho[j] * r + displacement[j]))
        r = max(r, float(ABOVE * (rho[-1] * radii[-2] + displacement[-1])))
    return radii
