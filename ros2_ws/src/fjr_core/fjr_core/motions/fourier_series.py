# SPDX-License-Identifier: Apache-2.0
"""Finite Fourier series that rest at the start and at the end of each period, as linear functions of coefficients.

    q_ld(t) = offset + sum_h a_h sin(w_h t) + b_h cos(w_h t),    w_h = 2 pi h / period

A motion that joins rest with class C^4 has dq = ddq = d3q = d4q = 0 at t = 0, which is four linear equations:

    sum a_h w_h = sum a_h w_h^3 = 0,    sum b_h w_h^2 = sum b_h w_h^4 = 0

The free coefficients span their null space. (J. Swevers et al., Optimal robot excitation and identification, IEEE
Transactions on Robotics and Automation 13(5), 1997, with rest at both ends in addition.)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import TrajectoryError
from ..numerics.checks import Array
from .reference import JETS
from .sine import MultiSine

FEWEST = 3
"""Harmonics with which sines and cosines can start at rest and still move."""


@dataclass(frozen=True, eq=False)
class RestingSeries:
    """Series of each joint with these m harmonics of a period [s].

    Free coefficients are (2 m - 3,), the last of them the offset.
    Raises TrajectoryError for fewer than three harmonics.
    """

    period: float
    harmonics: tuple[int, ...]

    def __post_init__(self) -> None:
        if len(self.harmonics) < FEWEST:
            raise TrajectoryError(f"the series has {len(self.harmonics)} harmonics; expected {FEWEST} or more")

    @property
    def frequencies(self) -> Array:
        """Angular frequencies (m,) [rad/s]."""
        return 2 * np.pi * np.array(self.harmonics) / self.period

    @cached_property
    def null_space(self) -> Array:
        """Orthonormal basis (2 m, 2 m - 4) of the coefficients (a_1 .. a_m, b_1 .. b_m) that start at rest.

        Coefficients are scaled by 1 / w^2, so that each basis vector has an acceleration of the same size.
        """
        ratio, m = self.frequencies / self.frequencies[-1], len(self.harmonics)
        rest = np.zeros((4, 2 * m))
        rest[:2, :m] = ratio**-1, ratio
        rest[2:, m:] = np.ones(m), ratio**2
        free = np.linalg.svd(rest)[2][4:].T
        return free / np.tile(self.frequencies**2, 2)[:, None]

    @property
    def size(self) -> int:
        """Number of free coefficients, the offset included."""
        return 2 * len(self.harmonics) - 3

    def jet_basis(self, t: Array) -> Array:
        """Return the matrix (5, k, size) that maps free coefficients to q_ld .. d4q_ld at t (k,) [s]."""
        w = self.frequencies
        angle = np.multiply.outer(t, w)
        basis = np.zeros((JETS, len(t), self.size))
        for row in range(JETS):
            shift = row * np.pi / 2
            waves = np.hstack([w**row * np.sin(angle + shift), w**row * np.cos(angle + shift)])
            basis[row, :, :-1] = waves @ self.null_space
        basis[0, :, -1] = 1.0
        return basis

    def reference(self, coefficients: Array) -> MultiSine:
        """Return the reference of free coefficients (size, n) of n joints."""
        n, m = coefficients.shape[1], len(self.harmonics)
        a, b = np.split(self.null_space @ coefficients[:-1], [m])
        frequency = np.repeat(self.frequencies[:, None], n, axis=1)
        return MultiSine(np.hypot(a, b), frequency, np.arctan2(b, a), coefficients[-1])


def logarithmic_harmonics(highest: int, count: int) -> tuple[int, ...]:
    """Return at most `count` harmonics from 1 to `highest`, spaced evenly on a logarithmic scale."""
    spaced = np.unique(np.geomspace(1, highest, count).round().astype(int))
    missing = [h for h in range(1, highest + 1) if h not in spaced][: count - len(spaced)]
    return tuple(int(h) for h in np.sort(np.append(spaced, np.array(missing, dtype=int))))
