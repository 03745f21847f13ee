# SPDX-License-Identifier: Apache-2.0
"""Divide a reference into cells of a few samples, with Taylor models of its derivatives on a window about each cell.

There are three kinds, of which `cells_of` chooses one: aligned cells are the samples of a period that is their
multiple; drifting cells cover any period, and their windows also cover the drift of the samples along them; sampled
cells cover any reference, but bounds on them are evaluated at points, not proven.
"""

from __future__ import annotations

from copy import copy
from typing import Any, NamedTuple

import numpy as np

from fjr_core.errors import ParameterError
from fjr_core.law.linearized import Indices
from fjr_core.motions.reference import JETS, Reference
from fjr_core.motions.sine import Sines, common_period
from fjr_core.numerics.checks import Array

from ..verification.taylor_models import Shape, TaylorModels, sine_derivative

DERIVATIVES = JETS + 1
"""Columns q .. d5q of a motion; the rate of the effort needs the fifth derivative."""
MOST_CELLS = {True: 1600, False: 1000}
"""Cells at which bounds are verified, or sampled."""
MOST_ALIGNED = 4000
"""Samples of a period up to which each is an aligned cell; the period must be a multiple of the sample period."""
IN_A_CYCLE = 800
"""Verified cells in a cycle of the fastest sine."""
ALIGNED = 4e-15  # relative error of a number of samples or cycles that counts as rounding
SLIP = 1e-6  # s; drift of aligned cells that windows cover: that of rounding in SLIP / ALIGNED, eight years
LONGEST = 60.0  # s; longest period or reference that is covered
SETTLED = 1.0  # s after the end of a reference that ends


class CellTimes(NamedTuple):
    """Windows of c cells: instants up to `radius` [s] before and after `middle` (c,) [s]."""

    middle: Array
    radius: float

    @property
    def instant(self) -> bool:
        """True if the window is a sampling instant."""
        return self.radius <= SLIP

    def of(self, cells: Indices) -> CellTimes:
        """Return the windows of the selected cells."""
        return CellTimes(self.middle[cells], self.radius)


class Cells:
    """c cells of `samples` sample periods each, that cover a reference: a period of it, or all of it.

    length [s]: of a cell; a little more than samples * sample_period if the period is not a multiple of it; drift
    [s]: this difference, if windows have to cover it. verified: bounds on the cells are verified, else sampled.
    aligned: the model of a cell does not hold after its end. middle, sampled (c,) [s]: middle of the window of each
    cell, and of the sampling instants in it; radius, reach [s]: half the lengths of these without drift. ends (c,) [s]:
    instants for which the deviations at the end of each cell stand.
    """

    verified, aligned = True, False

    def __init__(
        self, reference: Reference, sample_period: float, samples: int, count: int, length: float, periodic: bool
    ) -> None:
        self.reference, self.sample_period, self.periodic = reference, sample_period, periodic
        self.samples, self.count, self.length = samples, count, length
        self.starts: Array = np.asarray(length * np.arange(count), dtype=float)
        self.ends: Array = self.starts + length
        self.middle: Array = self.starts + length / 2
        self.sampled: Array = self.starts + (samples - 1) * sample_period / 2
        self.radius, self.reach, self.drift = length / 2, (samples - 1) * sample_period / 2, 0.0

    def windows(self, blocks: int) -> CellTimes:
        """Return the window of each cell.

        It contains every instant at which a chain of `blocks` cells, counted back from the cell of any sample, uses the
        model of the cell.
        """
        return CellTimes(self.middle, self.radius + blocks * self.drift)

    def sampling(self, blocks: int) -> CellTimes:
        """Return the sampling instants within `windows`."""
        return CellTimes(self.sampled, self.reach + blocks * self.drift)

    def acting(self, blocks: int, whole: int) -> tuple[CellTimes, float]:
        """Return windows from the sampling instant of an acting effort to the end of its action, and a share.

        whole: samples of the delay. The mean of a time over these instants differs from the middle of the window by at
        most the share of its radius. Sampled windows are those of the mean.
        """
        mean = self.reach + blocks * self.drift + self.sample_period / 2
        radius = mean + (whole + 1) * self.sample_period / 2 if self.verified else mean
        return CellTimes(self.sampled - whole * self.sample_period / 2, radius), mean / radius

    def beside(self, blocks: int) -> range:
        """Return the cells, relative to one, in which the samples of its windows lie."""
        return range(1)

    def sampled_beside(self, blocks: int) -> tuple[int, range]:
        """Return a sample of each cell, counted from its start, and others in the windows of it, relative to that.

        The samples are counted from time 0 on, over at most as many blocks.
        """
        slip = int(np.ceil(2 * blocks * self.drift / self.sample_period))
        middle = self.samples // 2 + 1
        reach = self.samples + middle + slip
        return middle, range(-reach, reach + 1)

    @property
    def verifiable(self) -> bool:
        """True if the bounds of `models` hold between points, and the cells cover all times."""
        return self.periodic and isinstance(self.reference, Sines)

    def before(self, cells: Indices, number: Indices) -> Indices:
        """Return the cells that lie a number of cells before the given ones; a reference at rest before time 0."""
        earlier = cells - number
        return earlier % self.count if self.periodic else np.maximum(earlier, 0)

    def along(self, reference: Reference) -> Cells:
        """Return the same cells of another reference with the same period."""
        cells = copy(self)
        cells.reference = reference
        return cells

    def models(self, window: CellTimes, shape: Shape) -> TaylorModels:
        """Return models of q .. d5q (6n, c) in the time of a window, which is -1 at its start and 1 at its end.

        The reference must be a sum of sines.
        """
        assert isinstance(self.reference, Sines)
        return TaylorModels.sines(self.reference, window.middle, window.radius, DERIVATIVES, shape)

    def columns(self, t: Array) -> Array:
        """Return the derivatives q .. d5q (6n, k) of the reference at times t (k,) [s]."""
        t = np.asarray(t) if self.periodic else np.maximum(t, 0.0)
        jets = self.reference.jets(t)
        if isinstance(self.reference, Sines):
            fifth = sine_derivative(self.reference, t, JETS)
        else:
            h = 1e-3 * self.sample_period
            fifth = (self.reference.jets(t + h)[:, -1] - self.reference.jets(np.maximum(t - h, 0.0))[:, -1]) / (2 * h)
        return np.concatenate([jets.reshape(len(t), -1), fifth], axis=1).T


class AlignedCells(Cells):
    """Verified cells of one sample each, whose period is their multiple but for rounding: windows are the cells."""

    aligned = True

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        hold = self.sample_period / 2
        self.middle = self.starts + hold
        self.sampled = self.middle - hold
        self.radius, self.reach = SLIP + hold, SLIP

    def beside(self, blocks: int) -> range:
        """Return the cell at whose start the window ends, too."""
        return range(2)

    def sampled_beside(self, blocks: int) -> tuple[int, range]:
        """Return the start of the cell, and its end."""
        return 0, range(2)


class DriftingCells(Cells):
    """Verified cells of any period; a sample that ends a cell is anywhere in it.

    Windows extend from samples - 1 samples before the cell to two samples after it, and by the accumulated drift more
    on either side. They are full of sampling instants.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        T, samples = self.sample_period, self.samples
        self.ends = self.starts + self.length / 2
        self.middle = self.sampled = self.starts + (self.length + (3 - samples) * T) / 2
        self.radius = self.reach = self.length / 2 + (samples + 1) * T / 2
        self.drift = abs(self.length - samples * T)

    def beside(self, blocks: int) -> range:
        """Return the cells in which the nearest sample of any time of the windows lies."""
        reach = (self.samples + 2) * self.sample_period + blocks * self.drift
        most = int(np.ceil(reach / self.length))
        return range(-most, most + 1)


class SampledCells(Cells):
    """Cells at whose points bounds are evaluated, of chains from the end of a cell: windows are the cells."""

    verified = False


def cells_of(reference: Reference, sample_period: float, verified: bool, most: int | None = None) -> Cells:
    """Return at most `most` cells of a reference, by default MOST_CELLS, or MOST_ALIGNED where they are aligned.

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
        if verified and _aligned(reference, whole, sample_period) and whole <= MOST_ALIGNED * sample_period:
            most = round(whole / sample_period)
        elif verified and isinstance(reference, Sines):
            most = int(min(most, max(1, IN_A_CYCLE * cycles(reference, whole))))
    samples = max(1, int(np.ceil(whole / sample_period / most * (1 - ALIGNED))))
    count = max(1, int(whole / (samples * sample_period) * (1 + ALIGNED)))  # no sample skips a cell
    kind: type[Cells] = DriftingCells if verified else SampledCells
    if verified and samples == 1 and _aligned(reference, whole, sample_period):
        kind = AlignedCells
    return kind(reference, sample_period, samples, count, whole / count, period is not None)


def cycles(reference: Sines, period: float) -> float:
    """Return the cycles of the fastest sine in a period [s]."""
    return float(np.abs(_moving(reference)).max() * period / (2 * np.pi))


def _aligned(reference: Reference, whole: float, sample_period: float) -> bool:
    """Return whether a time [s] is a multiple of the periods of samples and sines, but for rounding."""
    if not isinstance(reference, Sines):
        return False
    counts = np.append(_moving(reference) * whole / (2 * np.pi), whole / sample_period)
    return bool(np.all(np.abs(counts - np.round(counts)) <= ALIGNED * np.maximum(counts, 1.0)))


def _period(reference: Reference, sample_period: float) -> float | None:
    """Return the period [s] of a reference, one sample for a constant; None if it has none."""
    if not isinstance(reference, Sines):
        return None
    moving = _moving(reference)
    return common_period(moving) if np.any(moving) else sample_period


def _moving(reference: Sines) -> Array:
    """Return the frequencies [rad/s] of the sines, zero for those without amplitude."""
    amplitude, frequency, _ = reference.rows
    return np.where(amplitude == 0, 0.0, frequency)
