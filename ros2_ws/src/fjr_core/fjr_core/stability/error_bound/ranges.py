# SPDX-License-Identifier: Apache-2.0
"""Ranges of torque errors and slopes over the windows of a reference, a tube of deviations and a box of factors."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ...numerics.checks import Array
from .box import Box, enclosure
from .deviation_model import DeviationModel
from .invariant_tube import Spread
from .reference_cells import Cells
from .sampled_deviation import LinearCells

PIECES = {True: 8, False: 1}
"""Pieces of a window, each of which is a box, by whether ranges are verified."""
SAMPLED = 64  # cells at which ranges that are not verified are evaluated
POINTS = 8  # random corners of each box at which a sampled range is evaluated
SEED = 0
KEPT = 4.0  # ratio of a kept tube to a smaller one for which its range of the law is used again


class Ranges:
    """Ranges of the deviation model's functions: by interval arithmetic on verified cells, else at random corners."""

    def __init__(self, model: DeviationModel, cells: Cells) -> None:
        self.model, self.cells, self.pieces = model, cells, PIECES[cells.verified]
        count = cells.count if cells.verified else min(SAMPLED, cells.count)
        self._at = np.unique(np.linspace(0, cells.count - 1, count).round().astype(int))
        self._law: tuple[Array, int, Array] | None = None

    def known_torque(self, factors: Array) -> tuple[Array, Array]:
        """Return torque errors (c, 2n) [N m] in the middle of each cell at factors (7,), and those by age [N m/s]."""
        jets, f = self.cells.middles, np.tile(factors[:, None], self.cells.count)
        d_l, d_m, rate = (box.lower for box in sampled_range(self.model.torque_errors, Box(jets, jets), Box(f, f)))
        return np.concatenate([d_l, d_m]).T, np.concatenate([np.zeros_like(rate), -rate / factors[4]]).T

    def torque(self, low: Array, high: Array, blocks: int, delay: float, known: tuple[Array, Array]) -> Array:
        """Return bounds (2n,) [N m] of the torque errors along the reference minus those known; delay [s]."""
        n, age = self.model.n, delay + self.cells.sample_period
        d_l, d_m, rate = self._range(self.model.torque_errors, self._windows(blocks, age), self._factors(low, high))
        by_factor = [each / f for each in (rate.lower, rate.upper) for f in (low[4], high[4])]
        aging = Box(-np.max(by_factor, axis=0), -np.min(by_factor, axis=0))
        errors, by_age = (np.tile(each[self._at].T, self.pieces) for each in known)
        motors = d_m.distance(errors[n:]) + age * aging.distance(by_age[n:])
        return np.concatenate([d_l.distance(errors[:n]).max(axis=1), motors.max(axis=1)])

    def spread(
        self, linear: LinearCells, low: Array, high: Array, tube: Array, blocks: int, torque: Array
    ) -> Spread | None:
        """Return the differences from the linear model in a tube (4n,); None if they cannot be enclosed."""
        windows, deviations = self._windows(blocks), self._tube(tube)
        try:
            H, M = self._range(self.model.link_slope, windows, deviations, self._factors(low, high))
            F = self._law_spread(linear, tube, blocks)
        except ZeroDivisionError:
            return None
        G, B = self._range(self.model.motor_slope, self._factors(low, high))
        return Spread(
            torque,
            H=self._largest(H, linear.H),
            M=self._largest(M, linear.M),
            G=self._largest(G, np.tile(linear.G, (self.cells.count, 1, 1))),
            B=self._largest(B, np.tile(linear.B, (self.cells.count, 1, 1))),
            F=F,
        )

    def _law_spread(self, linear: LinearCells, tube: Array, blocks: int) -> Array:
        """Return the spread of the law's slope, kept for smaller tubes, for it does not depend on the factors."""
        if self._law is not None:
            kept, covered, found = self._law
            if covered >= blocks and np.all(tube <= kept) and np.any(KEPT * tube >= kept):
                return found
        windows = self._chosen(self.cells.sampling(blocks, self.pieces))
        (F,) = self._range(self.model.law_slope, windows, self._tube(tube))
        self._law = tube, blocks, self._largest(F, linear.F)
        return self._law[2]

    def _windows(self, blocks: int, earlier: float = 0.0) -> Box:
        return self._chosen(self.cells.windows(blocks, self.pieces, earlier))

    def _chosen(self, windows: Box) -> Box:
        at = (self.cells.count * np.arange(self.pieces)[:, None] + self._at).ravel()
        return Box(windows.lower[:, at], windows.upper[:, at])

    def _tube(self, tube: Array) -> Box:
        columns = np.tile(tube[:, None], self.pieces * len(self._at))
        return Box(-columns, columns)

    def _factors(self, low: Array, high: Array) -> Box:
        return Box(*(np.tile(each[:, None], self.pieces * len(self._at)) for each in (low, high)))

    def _range(self, function: ca.Function, *boxes: Box) -> list[Box]:
        return enclosure(function, *boxes) if self.cells.verified else sampled_range(function, *boxes)

    def _largest(self, box: Box, middle: Array) -> Array:
        """Return the largest distances (rows, columns) of matrices in boxes from those in the middle of the cells."""
        rows, columns = middle.shape[1:]
        flat = np.tile(middle[self._at].transpose(2, 1, 0).reshape(rows * columns, -1), self.pieces)
        return np.asarray(box.distance(flat).max(axis=1).reshape(columns, rows).T)


def sampled_range(function: ca.Function, *boxes: Box) -> list[Box]:
    """Return the ranges of the outputs (size, k) at random corners and the middles of k boxes (size, k)."""
    rng, k = np.random.default_rng(SEED), boxes[0].lower.shape[1]
    mapped = function.map(k)
    found: list[list[Array]] = [[] for _ in range(function.n_out())]
    for point in range(POINTS + 1):
        chosen = []
        for i, box in enumerate(boxes):
            share = np.full(box.lower.shape, 0.5) if point == 0 else rng.integers(0, 2, box.lower.shape)
            values = box.lower + share * (box.upper - box.lower)
            rows, columns = function.size_in(i)
            chosen.append(values.T.reshape(k, columns, rows).transpose(2, 0, 1).reshape(rows, -1))
        results = mapped(*chosen)
        for i, result in enumerate(results if isinstance(results, tuple) else (results,)):
            rows, columns = function.size_out(i)
            found[i].append(result.full().reshape(rows, k, columns).transpose(2, 0, 1).reshape(rows * columns, k))
    return [Box(np.min(values, axis=0), np.max(values, axis=0)) for values in found]
