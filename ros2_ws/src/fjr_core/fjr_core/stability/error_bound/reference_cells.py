# SPDX-License-Identifier: Apache-2.0
"""Divide a reference into cells of a few samples, and bound its derivatives on a window about each cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import ParameterError
from ...numerics.checks import Array
from ...trajectories.reference import JETS, Reference
from ...trajectories.sine import Sines, common_period
from .box import Box
from .deviation_model import DERIVATIVES

MOST_CELLS = {True: 800, False: 2500}
"""Cells at which bounds are verified, or sampled."""
LONGEST = 60.0  # s; longest period or reference that is covered
SETTLED = 1.0  # s after the end of a reference that ends


@dataclass(frozen=True, eq=False)
class Cells:
    """c cells of `samples` sample periods each, that cover a reference: a period of it, or all of it.

    length [s]: of a cell; differs a little from samples * sample_period if the period is not a multiple of it.
    verified: bounds are verified, else sampled.
    """

    reference: Reference
    sample_period: float
    samples: int
    count: int
    length: float
    periodic: bool
    verified: bool

    @property
    def verifiable(self) -> bool:
        """True if the bounds of `windows` hold between points, and the cells cover all times."""
        return self.periodic and isinstance(self.reference, Sines)

    @property
    def middles(self) -> Array:
        """Argument `jets` (6n, c) of the deviation model in the middle of each window."""
        return self._columns(self._middle)

    def before(self, cells: Array, number: int) -> Array:
        """Return the cells (k,) that lie `number` cells before the given ones; a reference at rest before time 0."""
        earlier = cells - number
        return np.asarray(earlier % self.count if self.periodic else np.maximum(earlier, 0))

    @property
    def instants(self) -> Array:
        """Argument `jets` (6n, c) in the middle of the sampling instants of each cell."""
        return self._columns(
            self._middle if self.verified else self._first + (self.samples - 1) * self.sample_period / 2
        )

    def windows(self, blocks: int, pieces: int, earlier: float = 0.0) -> Box:
        """Return bounds (6n, pieces c) of q_ld .. d5q_ld on the window of each cell: first all first pieces.

        The window contains every instant at which a chain of `blocks` cells, counted back from the cell of any sample,
        uses the model of the cell: from samples - 1 samples before the cell to two samples after it, and by the
        accumulated difference of `length` more on either side. earlier [s]: extends it. Sampled cells (not verified)
        are those of chains from the end of a cell: their windows are the cells.
        """
        radius = self.length / 2 + earlier
        if self.verified:
            drift = blocks * abs(self.length - self.samples * self.sample_period)
            radius += (self.samples + 1) * self.sample_period / 2 + drift
        return self._around(self._middle, radius, pieces)

    def sampling(self, blocks: int, pieces: int) -> Box:
        """Return bounds as `windows` on the sampling instants of each cell."""
        if self.verified:
            return self.windows(blocks, pieces)
        reach = (self.samples - 1) * self.sample_period / 2
        return self._around(self._first + reach, reach + abs(self.length - self.samples * self.sample_period), pieces)

    def _around(self, middle: Array, radius: float, pieces: int) -> Box:
        offsets = radius * (2 * np.arange(pieces) + 1 - pieces) / pieces
        middle = (middle + offsets[:, None]).ravel()
        if isinstance(self.reference, Sines):
            return _around_sines(self.reference, middle, radius / pieces)
        ends = [self._columns(middle + side * radius / pieces) for side in (-1, 0, 1)]
        return Box(np.min(ends, axis=0), np.max(ends, axis=0))

    @property
    def _first(self) -> Array:
        """First instant of each cell (c,) [s]."""
        return np.asarray(self.length * np.arange(self.count))

    @property
    def _middle(self) -> Array:
        """Middle of each window (c,) [s]."""
        later = (3 - self.samples) * self.sample_period if self.verified else 0.0
        return self._first + (self.length + later) / 2

    def _columns(self, t: Array) -> Array:
        t = np.asarray(t) if self.periodic else np.maximum(t, 0.0)
        jets = self.reference.jets(t)
        h = 1e-3 * self.sample_period
        fifth = (self.reference.jets(t + h)[:, -1] - self.reference.jets(np.maximum(t - h, 0.0))[:, -1]) / (2 * h)
        if isinstance(self.reference, Sines):
            fifth = _derivative(self.reference, t, JETS)
        return np.concatenate([jets.reshape(len(t), -1), fifth], axis=1).T


def cells_of(reference: Reference, sample_period: float, verified: bool) -> Cells:
    """Return the cells of a reference; raises ParameterError unless a period or its end is within LONGEST seconds."""
    period = _period(reference, sample_period)
    whole = reference.end + SETTLED if period is None else period
    if whole > LONGEST:
        raise ParameterError(
            f"the reference has neither a common period nor an end within {LONGEST:g} s; expected one of them for a "
            "bound of the tracking error"
        )
    samples = max(1, int(np.ceil(whole / sample_period / MOST_CELLS[verified])))
    count = max(1, round(whole / (samples * sample_period)))
    return Cells(reference, sample_period, samples, count, whole / count, period is not None, verified)


def _period(reference: Reference, sample_period: float) -> float | None:
    """Return the period [s] of a reference, one sample for a constant; None if it has none."""
    if not isinstance(reference, Sines):
        return None
    amplitude, frequency, _ = reference.rows
    moving = np.where(amplitude == 0, 0.0, frequency)
    return common_period(moving) if np.any(moving) else sample_period


def _derivative(reference: Sines, t: Array, order: int) -> Array:
    amplitude, frequency, phase = reference.rows
    angle = np.multiply.outer(t, frequency) + phase + order * np.pi / 2
    return np.asarray((amplitude * frequency**order * np.sin(angle)).sum(axis=-2))


def _around_sines(reference: Sines, t: Array, radius: float) -> Box:
    """Return bounds (6n, k) on t +- radius from the largest next derivative, sum of |amplitude frequency^i|."""
    amplitude, frequency, _ = reference.rows
    middle = [reference.jets(t)[:, i] for i in range(JETS)] + [_derivative(reference, t, JETS)]
    steepest = [np.abs(amplitude * frequency**i).sum(axis=0) for i in range(1, DERIVATIVES + 1)]
    rounding = 1e-12 * (1 + np.abs(np.concatenate(middle, axis=1)))
    reach = np.concatenate([radius * slope + np.zeros_like(middle[0]) for slope in steepest], axis=1)
    return Box.around(np.concatenate(middle, axis=1).T, (reach + rounding).T)
