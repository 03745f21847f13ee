# SPDX-License-Identifier: Apache-2.0
"""Divide a reference into cells of a few samples, with Taylor models of its derivatives on a window about each cell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial
from typing import NamedTuple

import numpy as np

from fjr_core.errors import ParameterError
from fjr_core.law.linearized import Indices
from fjr_core.motions.reference import JETS, Reference
from fjr_core.motions.sine import Sines, common_period
from fjr_core.numerics.checks import Array

from ..verification.taylor_models import Shape, TaylorModels
from .deviation_model import DERIVATIVES

MOST_CELLS = {True: 1600, False: 1000}
"""Cells at which bounds are verified, or sampled."""
MOST_ALIGNED = 4000
"""Samples of a period up to which each is a verified cell; it must be a multiple of the sample period."""
IN_A_CYCLE = 800
"""Verified cells in a cycle of the fastest sine."""
ALIGNED = 4e-15  # relative error of a number of samples or cycles that counts as rounding
SLIP = 1e-6  # s; drift of aligned cells that windows cover: that of rounding in SLIP / ALIGNED, eight years
LONGEST = 60.0  # s; longest period or reference that is covered
SETTLED = 1.0  # s after the end of a reference that ends
ROUNDING = 1e-11  # of a sum of sines, relative to the sum of its amplitudes


class Window(NamedTuple):
    """Windows of c cells: instants up to `radius` [s] before and after `middle` (c,) [s]."""

    middle: Array
    radius: float

    @property
    def instant(self) -> bool:
        """True if the window is a sampling instant."""
        return self.radius <= SLIP


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
        """True if the bounds of `models` hold between points, and the cells cover all times."""
        return self.periodic and isinstance(self.reference, Sines)

    @property
    def middles(self) -> Array:
        """Derivatives q .. d5q (6n, c) of the reference in the middle of each window."""
        return self.columns(self._middle)

    @property
    def ends(self) -> Array:
        """Instants (c,) [s] for which the deviations at the end of each cell stand."""
        late = self.verified and not self.aligned
        return np.asarray(self._first + self.length / (2 if late else 1))

    def before(self, cells: Indices, number: Indices) -> Indices:
        """Return the cells that lie a number of cells before the given ones; a reference at rest before time 0."""
        earlier = cells - number
        return earlier % self.count if self.periodic else np.maximum(earlier, 0)

    @property
    def instants(self) -> Array:
        """Derivatives (6n, c) as `middles`, in the middle of the sampling instants of each cell."""
        return self.columns(self._sampled)

    def along(self, reference: Reference) -> Cells:
        """Return the same cells of another reference with the same period."""
        return replace(self, reference=reference)

    @property
    def drift(self) -> float:
        """Difference [s] between a cell and its samples; 0 if aligned."""
        return 0.0 if self.aligned else abs(self.length - self.samples * self.sample_period)

    @cached_property
    def aligned(self) -> bool:
        """True if each sample of a period is a verified cell, and the period their multiple but for rounding."""
        return (
            self.verified
            and self.samples == 1
            and _aligned(self.reference, self.count * self.length, self.sample_period)
        )

    def windows(self, blocks: int) -> Window:
        """Return the window of each cell.

        It contains every instant at which a chain of `blocks` cells, counted back from the cell of any sample, uses the
        model of the cell. If aligned, that is the cell. Otherwise it extends from samples - 1 samples before the cell
        to two samples after it, and by the accumulated drift more on either side.
        Sampled cells (not verified) are those of chains from the end of a cell: their windows are the cells.
        """
        return Window(self._middle, self._reach(blocks) + self._hold if self.verified else self.length / 2)

    def sampling(self, blocks: int) -> Window:
        """Return the sampling instants within `windows`."""
        return Window(self._sampled, self._reach(blocks))

    def acting(self, blocks: int, whole: int) -> tuple[Window, float]:
        """Return windows from the sampling instant of an acting effort to the end of its action, and a share.

        whole: samples of the delay. The mean of a time over these instants differs from the middle of the window by at
        most the share of its radius. Sampled windows are those of the mean.
        """
        mean = self._reach(blocks) + self.sample_period / 2
        radius = mean + (whole + 1) * self.sample_period / 2 if self.verified else mean
        return Window(self._sampled - whole * self.sample_period / 2, radius), mean / radius

    def models(self, window: Window, shape: Shape) -> TaylorModels:
        """Return models of q .. d5q (6n, c) in the time of a window, which is -1 at its start and 1 at its end.

        The reference must be a sum of sines.
        """
        sines, order, t = self._sines, shape.order, window.middle
        amplitude, frequency, _ = sines.rows
        largest = [np.abs(amplitude * frequency**i).sum(axis=0) for i in range(DERIVATIVES + order)]
        largest[0] = largest[0] + np.abs(np.asarray(sines.offset))
        scale = [window.radius**k / factorial(k) for k in range(order + 1)]
        jets = [_derivative(sines, t, i) for i in range(DERIVATIVES + order - 1)]
        values = np.zeros((len(t), DERIVATIVES, self.reference.n, shape.width))
        for i in range(DERIVATIVES):
            for k in range(order):
                values[:, i, :, k] = scale[k] * jets[i + k]
                values[:, i, :, -1] += ROUNDING * scale[k] * largest[i + k]
            values[:, i, :, -1] += (1 + ROUNDING) * scale[order] * largest[i + order]
        return TaylorModels(values.reshape(len(t), -1, shape.width), shape)

    def columns(self, t: Array) -> Array:
        """Return the derivatives (6n, k) of the reference at times t (k,) [s]."""
        t = np.asarray(t) if self.periodic else np.maximum(t, 0.0)
        jets = self.reference.jets(t)
        if isinstance(self.reference, Sines):
            fifth = _derivative(self.reference, t, JETS)
        else:
            h = 1e-3 * self.sample_period
            fifth = (self.reference.jets(t + h)[:, -1] - self.reference.jets(np.maximum(t - h, 0.0))[:, -1]) / (2 * h)
        return np.concatenate([jets.reshape(len(t), -1), fifth], axis=1).T

    def _reach(self, blocks: int) -> float:
        """Return half the time [s] between the first and the last sampling instant of a window."""
        if not self.verified:
            return (self.samples - 1) * self.sample_period / 2
        if self.aligned:
            return SLIP
        return self.length / 2 + (self.samples + 1) * self.sample_period / 2 + blocks * self.drift

    @property
    def _hold(self) -> float:
        """Half the time [s] that a window of aligned cells extends beyond its last sampling instant."""
        return self.sample_period / 2 if self.aligned else 0.0

    @property
    def _sines(self) -> Sines:
        assert isinstance(self.reference, Sines)
        return self.reference

    @property
    def _first(self) -> Array:
        """First instant of each cell (c,) [s]."""
        return np.asarray(self.length * np.arange(self.count))

    @property
    def _middle(self) -> Array:
        """Middle of each window (c,) [s]."""
        if self.aligned:
            return self._first + self._hold
        later = (3 - self.samples) * self.sample_period if self.verified else 0.0
        return self._first + (self.length + later) / 2

    @property
    def _sampled(self) -> Array:
        """Middle of the sampling instants of each cell (c,) [s]."""
        if self.verified:
            return self._middle - self._hold
        return self._first + (self.samples - 1) * self.sample_period / 2


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
    if (
        most is None
        and verified
        and _aligned(reference, whole, sample_period)
        and whole <= MOST_ALIGNED * sample_period
    ):
        most = round(whole / sample_period)
    if most is None:
        most = MOST_CELLS[verified]
        if verified and isinstance(reference, Sines):
            most = int(min(most, max(1, IN_A_CYCLE * cycles(reference, whole))))
    samples = max(1, int(np.ceil(whole / sample_period / most * (1 - ALIGNED))))
    count = max(1, round(whole / (samples * sample_period)))
    return Cells(reference, sample_period, samples, count, whole / count, period is not None, verified)


def _aligned(reference: Reference, whole: float, sample_period: float) -> bool:
    """Return whether a time [s] is a multiple of the periods of samples and sines, but for rounding."""
    if not isinstance(reference, Sines):
        return False
    amplitude, frequency, _ = reference.rows
    cycles = np.where(amplitude == 0, 0.0, frequency) * whole / (2 * np.pi)
    counts = np.append(cycles, whole / sample_period)
    return bool(np.all(np.abs(counts - np.round(counts)) <= ALIGNED * np.maximum(counts, 1.0)))


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
    """Return a derivative (k, n) of a sum of sines at times t (k,) [s]."""
    amplitude, frequency, phase = reference.rows
    angle = np.multiply.outer(t, frequency) + phase + order * np.pi / 2
    derivative = (amplitude * frequency**order * np.sin(angle)).sum(axis=-2)
    return np.asarray(derivative + np.asarray(reference.offset) if order == 0 else derivative)
