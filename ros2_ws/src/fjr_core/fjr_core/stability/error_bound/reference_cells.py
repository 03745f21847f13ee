# SPDX-License-Identifier: Apache-2.0
"""Divide a reference into cells of a few samples, and bound its derivatives on a window about each cell."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import ParameterError
from ...numerics.checks import Array
from ...robot.equilibrium import Indices
from ...trajectories.reference import JETS, Reference
from ...trajectories.sine import Sines, common_period
from .box import Box
from .deviation_model import DERIVATIVES

MOST_CELLS = {True: 1600, False: 1000}
"""Cells at which bounds are verified, or sampled."""
IN_A_CYCLE = 800
"""Verified cells in a cycle of the fastest sine."""
PIECES = {True: 8, False: 3}
"""Pieces of the window of a cell: boxes by which bounds are verified, or instants at which they are sampled."""
LONGEST = 60.0  # s; longest period or reference that is covered
SETTLED = 1.0  # s after the end of a reference that ends
ROUNDING = 1e-11  # of a sum of sines, relative to the sum of its amplitudes


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
        """Derivatives q .. d5q (6n, c) of the reference in the middle of each window."""
        return self._columns(self._middle)

    @property
    def ends(self) -> Array:
        """Instants (c,) [s] for which the deviations at the end of each cell stand."""
        return np.asarray(self._first + self.length / (2 if self.verified else 1))

    def before(self, cells: Indices, number: int) -> Indices:
        """Return the cells (k,) that lie `number` cells before the given ones; a reference at rest before time 0."""
        earlier = cells - number
        return earlier % self.count if self.periodic else np.maximum(earlier, 0)

    @property
    def instants(self) -> Array:
        """Derivatives (6n, c) as `middles`, in the middle of the sampling instants of each cell."""
        return self._columns(self._sampled)

    def at(self, t: float) -> Array:
        """Return the derivatives (6n,) of the reference at time t [s]."""
        return np.asarray(self._columns(np.array([t]))[:, 0])

    def along(self, reference: Reference) -> Cells:
        """Return the same cells of another reference with the same period."""
        return replace(self, reference=reference)

    def windows(self, blocks: int, earlier: float = 0.0) -> Box:
        """Return bounds (6n, PIECES c) of q .. d5q on the window of each cell: first all first pieces.

        The window contains every instant at which a chain of `blocks` cells, counted back from the cell of any sample,
        uses the model of the cell: from samples - 1 samples before the cell to two samples after it, and by the
        accumulated difference of `length` more on either side. earlier [s]: extends it. Sampled cells (not verified)
        are those of chains from the end of a cell: their windows are the cells, and pieces are instants.
        """
        radius = self.length / 2
        if self.verified:
            radius = self.reach(blocks)
        return self._around(self._middle, radius + earlier)

    def reach(self, blocks: int) -> float:
        """Return half the length [s] of a window without `earlier`; of sampled cells for sampling instants."""
        if not self.verified:
            return (self.samples - 1) * self.sample_period / 2
        drift = blocks * abs(self.length - self.samples * self.sample_period)
        return self.length / 2 + (self.samples + 1) * self.sample_period / 2 + drift

    def sampling(self, blocks: int) -> Box:
        """Return bounds as `windows` on the sampling instants of each cell."""
        return self._around(self._sampled, self.reach(blocks))

    def middles_of_pieces(self, blocks: int) -> Box:
        """Return q .. d5q (6n, PIECES c) in the middle of the pieces of `sampling`."""
        return self._around_pieces(self._pieces(self._sampled, self.reach(blocks)), 0.0)

    def _around(self, middle: Array, radius: float) -> Box:
        return self._around_pieces(self._pieces(middle, radius), radius / PIECES[True])

    def _around_pieces(self, middle: Array, radius: float) -> Box:
        if self.verified and isinstance(self.reference, Sines):
            return _around_sines(self.reference, middle, radius)
        points = self._columns(middle)
        return Box(points, points)

    def _pieces(self, middle: Array, radius: float) -> Array:
        """Return the middle of each piece of windows about `middle` (c,); for sampled cells their instants."""
        count = PIECES[self.verified]
        places = (2 * np.arange(count) + 1 - count) / count if self.verified else np.linspace(-1, 1, count)
        return np.asarray((middle + radius * places[:, None]).ravel())

    @property
    def _first(self) -> Array:
        """First instant of each cell (c,) [s]."""
        return np.asarray(self.length * np.arange(self.count))

    @property
    def _middle(self) -> Array:
        """Middle of each window (c,) [s]."""
        later = (3 - self.samples) * self.sample_period if self.verified else 0.0
        return self._first + (self.length + later) / 2

    @property
    def _sampled(self) -> Array:
        """Middle of the sampling instants of each cell (c,) [s]."""
        return self._middle if self.verified else self._first + (self.samples - 1) * self.sample_period / 2

    def _columns(self, t: Array) -> Array:
        t = np.asarray(t) if self.periodic else np.maximum(t, 0.0)
        jets = self.reference.jets(t)
        if isinstance(self.reference, Sines):
            fifth = _derivative(self.reference, t, JETS)
        else:
            h = 1e-3 * self.sample_period
            fifth = (self.reference.jets(t + h)[:, -1] - self.reference.jets(np.maximum(t - h, 0.0))[:, -1]) / (2 * h)
        return np.concatenate([jets.reshape(len(t), -1), fifth], axis=1).T


def cells_of(reference: Reference, sample_period: float, verified: bool, most: int | None = None) -> Cells:
    """Return at most `most` cells of a reference, by default MOST_CELLS.

    Raises ParameterError unless a period or the end of the reference is within LONGEST seconds.
    """
    period = _period(reference, sample_period)
    whole = reference.end + SETTLED if period is None else period
    if whole > LONGEST:
        raise ParameterError(
            f"the reference has neither a common period nor an end within {LONGEST:g} s; expected one of them for a "
            "bound of the tracking error"
        )
    if most is None:
        most = MOST_CELLS[verified]
        if verified and isinstance(reference, Sines):
            most = int(min(most, max(1, IN_A_CYCLE * cycles(reference, whole))))
    samples = max(1, int(np.ceil(whole / sample_period / most)))
    count = max(1, round(whole / (samples * sample_period)))
    return Cells(reference, sample_period, samples, count, whole / count, period is not None, verified)


def _period(reference: Reference, sample_period: float) -> float | None:
    """Return the period [s] of a reference, one sample for a constant; None if it has none."""
    if not isinstance(reference, Sines):
        return None
    amplitude, frequency, _ = reference.rows
    moving = np.where(amplitude == 0, 0.0, frequency)
    return common_period(moving) if np.any(moving) else sample_period


def cycles(reference: Sines, period: float) -> float:
    """Return the cycles of the fastest sine in a period [s]."""
    amplitude, frequency, _ = reference.rows
    return float(np.abs(np.where(amplitude == 0, 0.0, frequency)).max() * period / (2 * np.pi))


def _derivative(reference: Sines, t: Array, order: int) -> Array:
    amplitude, frequency, phase = reference.rows
    angle = np.multiply.outer(t, frequency) + phase + order * np.pi / 2
    return np.asarray((amplitude * frequency**order * np.sin(angle)).sum(axis=-2))


def _around_sines(reference: Sines, t: Array, radius: float) -> Box:
    """Return bounds (6n, k) on t +- radius from the largest next derivative, sum of |amplitude frequency^i|."""
    amplitude, frequency, _ = reference.rows
    middle = [*reference.jets(t).swapaxes(0, 1), _derivative(reference, t, JETS)]
    largest = [np.abs(amplitude * frequency**i).sum(axis=0) for i in range(DERIVATIVES + 1)]
    largest[0] = largest[0] + np.abs(np.asarray(reference.offset))
    reach = [radius * slope + ROUNDING * size for size, slope in zip(largest, largest[1:], strict=False)]
    return Box.around(np.concatenate(middle, axis=1).T, np.tile(np.concatenate(reach)[:, None], len(t)))
