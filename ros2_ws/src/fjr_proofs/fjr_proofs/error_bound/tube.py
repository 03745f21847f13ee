# SPDX-License-Identifier: Apache-2.0
"""Tubes of deviations, and the random points at which ranges are sampled where they are not verified."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array

POINTS = 4  # of tube and factors at each instant: their middle, and random corners
INSTANTS = (-1.0, 0.0, 1.0)  # of a window, relative to its radius
SEED = 0


@dataclass(frozen=True, eq=False)
class Tube:
    """Deviations z (4n,) in c cells: sums of `directions` (4n, m) and of `lines` (c, 4n, u), each times -1 to 1."""

    directions: Array
    lines: Array

    @property
    def symbols(self) -> int:
        """Number m + u of symbols of a model."""
        return self.directions.shape[1] + self.lines.shape[2]

    @property
    def box(self) -> Array:
        """Bounds (4n,) of |z|."""
        return np.asarray(np.abs(self.directions).sum(axis=1) + np.abs(self.lines).sum(axis=2).max(axis=0))

    @property
    def slopes(self) -> Array:
        """Slopes (4n, m + u, c) of z in the symbols."""
        everywhere = np.broadcast_to(self.directions, (len(self.lines), *self.directions.shape))
        return np.concatenate([everywhere, self.lines], axis=2).transpose(1, 2, 0)

    def corners(self, share: Array) -> Array:
        """Return points (4n, k) of a tube without lines at shares (m, k) of its width."""
        return np.asarray(self.directions @ (2 * share - 1))


def shares(size: int, k: int) -> list[Array]:
    """Return shares (size, k) of widths: the middles of k boxes, then random corners."""
    rng = np.random.default_rng(SEED)
    return [np.full((size, k), 0.5), *rng.integers(0, 2, (POINTS - 1, size, k)).astype(float)]
