# SPDX-License-Identifier: Apache-2.0
"""Ranges of torque errors and slopes over the windows of a reference, a tube of deviations and a box of factors."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ...numerics.checks import Array
from ...numerics.interval_evaluation import Box, enclosure
from .deviation_model import DeviationModel
from .invariant_tube import Spread
from .reference_cells import PIECES, Cells
from .sampled_deviation import LinearCells

POINTS = 4  # random corners of each box at which a sampled range is evaluated
SEED = 0
KEPT = 4.0  # ratio of a kept tube to a smaller one for which its range of the law is used again


class Ranges:
    """Ranges of the functions of a deviation model, by interval arithmetic if `verified`, else at random corners."""

    def __init__(self, model: DeviationModel, cells: Cells, verified: bool) -> None:
        self.model, self.cells, self.verified = model, cells, verified
        self._law: tuple[Array, int, Array] | None = None

    def middle_torque(self, factors: Array, delay: float) -> Array:
        """Return the torque errors (c, 2n) [N m] at factors (7,) in the middle of each cell, and of the mean hold."""
        jets, f = self.cells.middles, np.tile(factors[:, None], self.cells.count)
        d_l, d_m, rate = (box.lower for box in sampled_range(self.model.torque_errors, Box(jets, jets), Box(f, f)))
        age = delay + self.cells.sample_period / 2
        return np.concatenate([d_l, d_m - age * rate / factors[4]]).T

    def torque(self, low: Array, high: Array, blocks: int, delay: float, middle: Array) -> Array:
        """Return bounds (2n,) [N m] of the torque errors along the reference minus `middle` (c, 2n); delay [s]."""
        age = delay, delay + self.cells.sample_period
        windows = self.cells.windows(blocks, age[1])
        d_l, d_m, rate = self._range(self.model.torque_errors, windows, self._factors(low, high))
        ends = [-time * each / f for time in age for each in (rate.lower, rate.upper) for f in (low[4], high[4])]
        d_m = Box(d_m.lower + np.min(ends, axis=0), d_m.upper + np.max(ends, axis=0))
        points = np.tile(middle.T, PIECES)
        n = self.model.n
        return np.concatenate([d_l.distance(points[:n]).max(axis=1), d_m.distance(points[n:]).max(axis=1)])

    def spread(
        self, linear: LinearCells, low: Array, high: Array, tube: Array, blocks: int, torque: Array
    ) -> Spread | None:
        """Return the differences from the linear model in a tube (4n,); None if they cannot be enclosed."""
        windows, deviations = self.cells.windows(blocks), self._tube(tube)
        try:
            H, M = self._range(self.model.link_slope, windows, deviations, self._factors(low, high))
            F = self._law_spread(linear, tube, blocks)
        except ZeroDivisionError:
            return None
        G, B = self._range(self.model.motor_slope, self._factors(low, high))
        return Spread(
            torque,
            H=_largest(H, linear.H),
            M=_largest(M, linear.M),
            G=_largest(G, np.tile(linear.G, (self.cells.count, 1, 1))),
            B=_largest(B, np.tile(linear.B, (self.cells.count, 1, 1))),
            F=F,
        )

    def _law_spread(self, linear: LinearCells, tube: Array, blocks: int) -> Array:
        """Return the spread of the law's slope, kept for smaller tubes, for it does not depend on the factors."""
        if self._law is not None:
            kept, covered, found = self._law
            if covered >= blocks and np.all(tube <= kept) and np.any(KEPT * tube >= kept):
                return found
        (F,) = self._range(self.model.law_slope, self.cells.windows(blocks), self._tube(tube))
        self._law = tube, blocks, _largest(F, linear.F)
        return self._law[2]

    def _tube(self, tube: Array) -> Box:
        columns = np.tile(tube[:, None], PIECES * self.cells.count)
        return Box(-columns, columns)

    def _factors(self, low: Array, high: Array) -> Box:
        return Box(*(np.tile(each[:, None], PIECES * self.cells.count) for each in (low, high)))

    def _range(self, function: ca.Function, *boxes: Box) -> list[Box]:
        return enclosure(function, *boxes) if self.verified else sampled_range(function, *boxes)


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


def _largest(box: Box, middle: Array) -> Array:
    """Return the largest distances (rows, columns) of matrices in boxes (size, PIECES c) from those in the middle."""
    rows, columns = middle.shape[1:]
    flat = np.tile(middle.transpose(2, 1, 0).reshape(rows * columns, -1), PIECES)
    return np.asarray(box.distance(flat).max(axis=1).reshape(columns, rows).T)
