# SPDX-License-Identifier: Apache-2.0
"""Divide a box of factors into parts, each of which has a tube that the deviations do not leave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...control.static_law import StaticLaw
from ...numerics.checks import Array
from ...trajectories.reference import Reference
from .deviation_model import DeviationModel
from .invariant_tube import Centre, Deviations, centre_of, fixed_point
from .peak_gains import peak_gains
from .ranges import Ranges
from .reference_cells import cells_of
from .sampled_deviation import LinearCells, law_slopes, linear_cells

MOST_PARTS = 64
NARROWEST = 0.01  # width of factors of a part that is not divided
TIGHT = 1.5  # ratio of a bound to that without feedback, below which a part is not divided
REMAINS = 1e-3  # of a deviation after the sums of the gains
LONGEST_SUM = 20_000  # samples
SAMPLED_FINALS = 64  # cells at whose end the gains of a sampled bound are computed
CREDIBLE = 0.3  # rad; largest position of a tube whose constants are sampled
GROWTH, ROUNDS = 1.5, 8  # of the tube that is tried
SHRINKS = 0.9  # ratio of an ultimate bound to the last one at which it is final


@dataclass(frozen=True, eq=False)
class Part:
    """Part of the box of factors, low to high (7,).

    tube: ultimate bounds. least (4n,): these without feedback of z. from_start: bounds at all times, if verified.
    """

    low: Array
    high: Array
    tube: Deviations | None = None
    least: Array = field(default_factory=lambda: np.zeros(0))
    from_start: Deviations | None = None

    @property
    def size(self) -> float:
        """Largest bound of a position; infinite without a tube."""
        return np.inf if self.tube is None else float(self.tube.z[: self.tube.effort.size].max())

    @property
    def excess(self) -> float:
        """Ratio of the bound of the positions to that without feedback of z."""
        if self.tube is None:
            return np.inf
        n = self.tube.effort.size
        return float(np.max(self.tube.z[:n] / np.maximum(self.least[:n], 1e-12)))

    def divided(self) -> list[tuple[Array, Array]]:
        """Return both halves, divided at the widest factor."""
        widest = int(np.argmax(self.high - self.low))
        left, right = self.high.copy(), self.low.copy()
        left[widest] = right[widest] = (self.low[widest] + self.high[widest]) / 2
        return [(self.low, left), (right, self.high)]


Within = Callable[[Array], Deviations | None]
"""Return bounds of the deviations that hold while these stay within a tube (4n,); None without any."""


def _grown(within: Within, first: Array) -> Deviations | None:
    """Return bounds that lie within their tube, which grows from `first` (4n,) on; None if none are found."""
    tube = GROWTH * first
    for _ in range(ROUNDS):
        found = within(tube)
        if found is None or np.all(found.z <= tube):
            return found
        tube = GROWTH * np.maximum(found.z, tube / GROWTH)
    return None


def _shrunk(within: Within, tube: Deviations) -> Deviations:
    """Return ultimate bounds of deviations that stay within a tube: each bound is the tube of the next one."""
    for _ in range(ROUNDS):
        found = within(tube.z)
        if found is None:
            return tube
        bounded = replace(found, z=np.minimum(found.z, tube.z))
        if np.all(bounded.z > SHRINKS * tube.z):
            return bounded
        tube = bounded
    return tube


class Search:
    """Division of the box of factors into parts with invariant tubes."""

    def __init__(
        self, law: StaticLaw, reference: Reference, T: float, delay: float, disturbing: Array, verified: bool
    ) -> None:
        """disturbing (2n,) [N m]: torques on links and motors beside the errors of the factors."""
        self.model, self.cells = DeviationModel(law), cells_of(reference, T, verified)
        self.T, self.delay, self.disturbing = T, delay, disturbing
        self.ranges = Ranges(self.model, self.cells)

    @property
    def applies(self) -> bool:
        """True if the constants can be verified: closed-form links, and a reference with bounds between points."""
        return self.cells.verifiable and self.model.robot.links.M_l_vertices is not None

    @cached_property
    def F(self) -> Array:
        """Slopes of the law in each cell."""
        return law_slopes(self.model, self.cells)

    def parts(self, low: Array, high: Array) -> list[Part]:
        """Divide the part with the largest bound until it is tight, or cannot become tighter.

        If the smallest part at the largest factors has no tube either, it is returned alone.
        """
        parts = [self._part(low, high)]
        if parts[0].tube is None:
            smallest = self._part(np.maximum(low, high - NARROWEST), high)
            if smallest.tube is None:
                return [smallest]
        while len(parts) < MOST_PARTS:
            worst = max(reversed(parts), key=lambda part: part.size)
            if worst.excess <= TIGHT or np.all(worst.high - worst.low <= NARROWEST):
                break
            parts.remove(worst)
            parts += [self._part(*ends) for ends in worst.divided()]
        return parts

    def _part(self, low: Array, high: Array) -> Part:
        """Return the part of the box between the factors low and high (7,), with its invariant tube if there is one."""
        linear = linear_cells(self.model, self.cells, self.F, (low + high) / 2, self.T, self.delay)
        blocks = self._blocks(linear)
        if blocks is None:
            return Part(low, high)
        gains = peak_gains(linear.models, self.cells, self.T, blocks, self._finals)
        if not np.all(np.isfinite(gains)):
            return Part(low, high)
        known = self.ranges.known_torque((low + high) / 2)
        unknown = self.ranges.torque(low, high, blocks, self.delay, known) + self.disturbing
        centre = centre_of(linear, self.cells, *known)
        least = gains[: 4 * self.model.n, : 2 * self.model.n] @ unknown + centre.z

        def within(tube: Array, torque: Array, about: Centre) -> Deviations | None:
            spread = self.ranges.spread(linear, low, high, tube, blocks, torque)
            return None if spread is None else fixed_point(linear, gains, spread, about)

        if not self.cells.verified:
            tube = _grown(lambda tube: within(tube, unknown, centre), least)
            credible = tube is not None and tube.z[: self.model.n].max() <= CREDIBLE
            return Part(low, high, tube if credible else None, least)
        largest = unknown + np.max(np.abs(known[0]) + (self.delay + self.T) * np.abs(known[1]), axis=0)
        first = gains[: 4 * self.model.n, : 2 * self.model.n] @ largest
        from_start = _grown(lambda tube: within(tube, largest, centre.none()), first)
        if from_start is None:
            return Part(low, high)
        ultimate = _shrunk(lambda tube: within(tube, unknown, centre), from_start)
        return Part(low, high, ultimate, least, from_start)

    def _blocks(self, linear: LinearCells) -> int | None:
        """Return the number of cells after which a deviation has decayed to REMAINS; None for an unstable loop."""
        radius = float(np.abs(np.linalg.eigvals(linear.models.loop)).max())
        if not radius < 1:
            return None
        samples = np.log(REMAINS) / np.log(radius) if radius > 0 else 1.0
        return None if samples > LONGEST_SUM else int(np.ceil(samples / self.cells.samples)) + 1

    @property
    def _finals(self) -> Array:
        count = self.cells.count if self.cells.verified else min(SAMPLED_FINALS, self.cells.count)
        return np.unique(np.linspace(0, self.cells.count - 1, count).round().astype(int))
