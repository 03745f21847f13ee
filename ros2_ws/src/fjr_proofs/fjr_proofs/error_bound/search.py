# SPDX-License-Identifier: Apache-2.0
"""Divide a box of factors into parts, each of which has a tube that the deviations do not leave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np

from fjr_core.errors import StateError
from fjr_core.law.interfaces import StaticLaw
from fjr_core.law.linearized import Indices
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array

from ..verification.taylor_models import taylor_function
from .centre_motion import CentreMotion
from .deviation_model import DeviationModel
from .part import Part
from .peak_gains import peak_gains
from .ranges import Ranges
from .reference_cells import Cells, cells_of
from .sampled_deviation import LinearCells, linear_cells
from .steady_motion import spectral_radius, steady_motion
from .tube_problem import TubeProblem

MOST_PARTS = 128
HOPELESS = 1000  # parts of the whole box, if all were as narrow as those of one part, at which the division ends
TIGHT = 1.1  # ratio of a bound to that of the known response, below which a part is not divided
WORTH = 0.95  # ratio of the bounds of halves to that of a part, up to which it is divided
REMAINS = 1e-3  # of a deviation after the sums of the gains
LONGEST_SUM = 20_000  # samples
SAMPLED_FINALS = 16  # cells at whose end the gains of a sampled bound are computed
COARSE = 100  # cells on which centre motions are found

Progress = Callable[[float], None]
"""Called with the share of the parts found so far that have a tube, 0 to 1; falls when a part is divided."""


class Search:
    """Division of the box of factors into parts with invariant tubes."""

    def __init__(
        self, law: StaticLaw, reference: Reference, T: float, delay: float, disturbing: Array, verified: bool
    ) -> None:
        """disturbing (2n,) [N m]: torques on links and motors beside the errors of the factors."""
        self.model, self.cells = DeviationModel(law), cells_of(reference, T, verified)
        self.T, self.delay, self.disturbing = T, delay, disturbing

    @property
    def applies(self) -> bool:
        """True if the constants can be verified.

        That takes a reference with bounds between points and a law of known operations.
        """
        if not self.cells.verifiable:
            return False
        model = self.model
        try:
            for function in (model.law_slope, model.defect):
                taylor_function(function)
        except StateError:
            return False
        return True

    def parts(self, low: Array, high: Array, progress: Progress = lambda share: None) -> list[Part]:
        """Divide the box until each part has a tube, then the part with the largest bound until it is tight.

        The division ends, with a part that has no tube, where a part is narrow or the parts are, or will be, too many.
        """
        waiting: list[tuple[Array, Array, CentreMotion | None]] = [(low, high, None)]
        parts: list[Part] = []
        while waiting:
            part = self._part(*waiting.pop())
            if part.found:
                parts.append(part)
                progress(len(parts) / (len(parts) + len(waiting)))
                continue
            counts = part.counts()
            boxes = np.prod(counts, dtype=float)
            if part.narrow or len(waiting) + len(parts) + boxes > MOST_PARTS or boxes > HOPELESS * part.of(low, high):
                return [part]
            waiting += [(*ends, part.centre) for ends in part.divided(counts)]
        return self._tightened(parts)

    def _tightened(self, parts: list[Part]) -> list[Part]:
        while len(parts) < MOST_PARTS:
            worst = max(parts, key=lambda part: part.size)
            if worst.excess <= TIGHT or worst.narrow:
                break
            halves = [self._part(*ends, worst.centre) for ends in worst.divided(worst.counts())]
            if max(half.size for half in halves) > WORTH * worst.size:
                break
            parts = [part for part in parts if part is not worst] + halves
        return parts

    def _part(self, low: Array, high: Array, start: CentreMotion | None) -> Part:
        """Return the part of the box between the factors low and high (7,), with its invariant tube if there is one."""
        n, middle = self.model.n, (low + high) / 2
        centre = steady_motion(self.model, self.coarse, middle, self.delay, start).about(self.cells, middle)
        linear, none = linear_cells(self.model, centre, self.delay), np.full(2 * n, np.inf)
        part = Part(low, high, centre, np.ones(np.count_nonzero(high > low)), none, none, none)
        blocks = self._blocks(linear)
        if blocks is None:
            return part
        gains = peak_gains(linear.models, self.cells, self.T, blocks, self._finals)
        if not np.all(np.isfinite(gains)):
            return part
        ranges = Ranges(self.model, centre, low, high, blocks, self.delay)
        try:
            return _solved(part, TubeProblem(linear, gains, ranges, self.disturbing))
        except ZeroDivisionError:  # a divisor may be zero: the part is too wide
            return part

    @cached_property
    def coarse(self) -> Cells:
        """Cells on which centre motions are found."""
        return cells_of(self.cells.reference, self.T, self.cells.verified, COARSE)

    def _blocks(self, linear: LinearCells) -> int | None:
        """Return the number of cells after which a deviation has decayed to REMAINS; None for an unstable loop."""
        radius = spectral_radius(linear.at(self._finals))
        if not radius < 1:
            return None
        samples = np.log(REMAINS) / np.log(radius) if radius > 0 else 1.0
        return None if samples > LONGEST_SUM else int(np.ceil(samples / self.cells.samples)) + 1

    @property
    def _finals(self) -> Indices:
        count = self.cells.count if self.cells.verified else min(SAMPLED_FINALS, self.cells.count)
        return np.unique(np.linspace(0, self.cells.count - 1, count).round().astype(int))


def _solved(part: Part, problem: TubeProblem) -> Part:
    """Return the part with the bounds of its problem."""

    def bound(z: Array) -> Array:
        q, _, dq, _ = np.split(z, 4)
        return np.asarray(part.centre.largest + np.concatenate([q, dq]))

    part = replace(part, effect=problem.effect, first_order=bound(problem.in_joints()))
    if problem.tube is None:
        return replace(part, share=problem.share)
    storage = problem.ranges.storage(problem.as_tube(problem.tube))
    part = replace(part, ultimate=bound(problem.in_joints(problem.tube)), storage=storage)
    if problem.from_start is None:
        return part
    return replace(part, from_start=bound(problem.as_tube(problem.from_start).box))
