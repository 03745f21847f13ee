# SPDX-License-Identifier: Apache-2.0
"""Centre of a tube: a motion of the robot with given factors, near the one in which its sampled loop is steady.

The links of the centre motion move along the reference plus a Fourier series, a sum of sines with its period; springs,
motors and effort follow from the inverse dynamics of the robot. The defect of the law along the centre motion is small,
if the series is that of the steady motion. Newton's method finds it: the steady response of the linear model to the
defect is added to the series. A bound holds for any series; a better one makes it smaller.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fjr_core.motions.sine import MultiSine, Sines
from fjr_core.numerics.checks import Array

from .peak_gains import ROUNDING
from .reference_cells import Cells, cycles

HARMONICS = 6
"""Highest harmonic of the series, relative to the highest frequency of the reference."""
POINTS = 8
"""Points in a cell at which the series is evaluated for its largest value."""
NEGLIGIBLE = 1e-6  # of the largest coefficient


@dataclass(frozen=True, eq=False)
class CentreMotion:
    """Motion of the links along the reference of `cells` plus a Fourier series, of a robot with `factors` (7,).

    series (k + 1, n) complex: q_lc - q_ld = sum of Re(series[i] exp(j i w t)), w the base frequency of the period.
    """

    cells: Cells
    factors: Array
    series: Array

    @classmethod
    def ideal(cls, cells: Cells, factors: Array) -> CentreMotion:
        """Return the motion whose links stay on the reference."""
        return cls(cells, factors, np.zeros((1, cells.reference.n), dtype=complex))

    def about(self, cells: Cells, factors: Array) -> CentreMotion:
        """Return the same motion of the links on other cells of the reference, of a robot with other factors."""
        return replace(self, cells=cells, factors=factors)

    @property
    def base(self) -> float:
        """Base frequency w [rad/s]."""
        return 2 * np.pi / (self.cells.length * self.cells.count)

    @cached_property
    def largest(self) -> Array:
        """Bounds (2n,) of |q_lc - q_ld| [rad] and |dq_lc - dq_ld| [rad/s] at all times.

        Between points a sum of sines differs from the nearer one by at most half their distance times its largest rate.
        """
        amplitude, frequency, _ = rows = _rows(self.series, self.base)
        correction = MultiSine(*rows, offset=self.series[0].real)
        apart = self.cells.length / POINTS
        jets = correction.jets(apart * np.arange(POINTS * self.cells.count))
        rates = np.concatenate([(amplitude * frequency**i).sum(axis=0) for i in (1, 2)])
        return ROUNDING * (np.abs(jets[:, :2]).max(axis=0).ravel() + apart / 2 * rates)

    @property
    def path(self) -> Cells:
        """The cells of the motion of the links."""
        reference = self.cells.reference
        if not np.any(self.series) or not isinstance(reference, Sines):
            return self.cells
        rows = zip(reference.rows, _rows(self.series, self.base), strict=True)
        amplitude, frequency, phase = (np.concatenate(pair) for pair in rows)
        offset = np.asarray(reference.offset) + self.series[0].real
        return self.cells.along(MultiSine(amplitude, frequency, phase, offset))

    def moved(self, q: Array) -> CentreMotion:
        """Return the motion with deviations q (c, n) [rad] at the ends of the cells added to the series."""
        t = self.cells.ends
        harmonics = np.arange(self._highest + 1)
        added = 2 / len(t) * np.exp(-1j * self.base * np.outer(harmonics, t)) @ q
        added[0] = added[0].real / 2
        series = np.zeros((max(len(added), len(self.series)), q.shape[1]), dtype=complex)
        series[: len(self.series)] = self.series
        series[: len(added)] += added
        series[np.abs(series) < NEGLIGIBLE * np.abs(series).max()] = 0
        return replace(self, series=series)

    @property
    def _highest(self) -> int:
        """Number of harmonics that the cells resolve."""
        reference = self.cells.reference
        if not isinstance(reference, Sines):
            return 0
        fastest = cycles(reference, self.cells.length * self.cells.count)
        return int(min(round(HARMONICS * fastest), (self.cells.count - 1) // 4))


def _rows(series: Array, base: float) -> tuple[Array, Array, Array]:
    """Return amplitude, frequency and phase (k, n) of the sines of a series; at least one."""
    harmonics = np.append(np.flatnonzero(np.any(series[1:], axis=1)) + 1, [] if np.any(series[1:]) else 0).astype(int)
    terms = np.where(harmonics[:, None] > 0, series[harmonics], 0)
    frequency = base * harmonics[:, None] + np.zeros(terms.shape)
    return np.abs(terms), frequency, np.angle(terms) + np.pi / 2
