# SPDX-License-Identifier: Apache-2.0
"""Ranges of errors and slopes over the windows of a centre motion, a tube about it and a box of factors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from ...numerics.checks import Array
from .box import Box, Tube, enclosure
from .centre_motion import CentreMotion
from .deviation_model import FACTORS, DeviationModel
from .invariant_tube import Spread
from .peak_gains import ROUNDING
from .reference_cells import PIECES, Cells
from .sampled_deviation import LinearCells
from .sampled_ranges import sampled_range, sampled_values
from .steady_response import Drive

SAMPLED = 24  # cells at which ranges that are not verified are evaluated
CLIMBS = 6  # corners of a tube that are tried for the largest V
INERTIA = FACTORS.index("motor_inertia")


@dataclass(frozen=True, eq=False)
class Ranges:
    """Ranges of the deviation model's functions about a centre motion, for factors from low to high (7,).

    They are found by interval arithmetic on verified cells, else at random corners. blocks: cells of the sums of the
    gains. delay [s].
    """

    model: DeviationModel
    centre: CentreMotion
    low: Array
    high: Array
    blocks: int
    delay: float

    def drive(self) -> Drive:
        """Return the known torques and efforts: of the centre motion, by each uncertain factor, by each torque term."""
        c, uncertain = self._constant(self.centre.factors), self._half > 0
        points = Box.point(self._path.instants), Box.point(self._jets.instants), c
        defect, _, rate = self._values(self.model.defect, *points)
        slopes, _, second = self._coefficients
        terms = self._terms
        by_factor, by_term = (terms @ (slopes * self._half))[:, :, uncertain], (terms * second)[:, :, second > 0]
        torque = np.concatenate([np.zeros_like(terms[:, :, :1]), by_factor, by_term], axis=2)
        aging = np.concatenate([np.zeros_like(rate), -rate / self.centre.factors[INERTIA]]).T
        return Drive(torque, aging, defect.T)

    def unknown(self, drive: Drive) -> Array:
        """Return bounds (4n,) of torques, accelerations and defects along the centre motion beside those of a drive."""
        n, age = self.model.n, self.delay + self._jets.sample_period
        c = self._factors(self.centre.factors, self.centre.factors)
        (terms,) = self._range(self.model.torque_terms, self._windows(self._path), c)
        middle = self._tiled(self._terms.swapaxes(1, 2).reshape(self._jets.count, -1))
        apart = terms.distance(middle).reshape(len(self._coefficients[1]), 2 * n, -1)
        torque = np.einsum("j,jik->ik", self._coefficients[1], apart).max(axis=1)
        earlier = self._windows(self._path, age), self._windows(self._jets, age), c
        rate = self._range(self.model.defect, *earlier)[2]
        inertias = self.low[INERTIA], self.high[INERTIA]
        by_factor = [each / f for each in (rate.lower, rate.upper) for f in inertias]
        aging = Box(-np.max(by_factor, axis=0), -np.min(by_factor, axis=0))
        torque[n:] += age * aging.distance(self._tiled(drive.aging[:, n:])).max(axis=1)
        return np.concatenate([torque, np.zeros(n), self._defect_spread(drive.effort)])

    @property
    def _half(self) -> Array:
        return (self.high - self.low) / 2

    @cached_property
    def _terms(self) -> Array:
        """Torque terms (c, 2n, 6) in the middle of the cells."""
        (terms,) = self._values(
            self.model.torque_terms, Box.point(self._path.middles), self._constant(self.centre.factors)
        )
        return np.asarray(terms.T.reshape(self._jets.count, -1, 2 * self.model.n).swapaxes(1, 2))

    @cached_property
    def _coefficients(self) -> tuple[Array, Array, Array]:
        """Derivatives (6, 7) of the coefficients of the torque terms, their largest values and second order (6,)."""
        c, half = self.centre.factors[:, None], self._half
        middle = self.model.coefficients(c, c).full()
        (box,) = enclosure(self.model.coefficients, Box.point(c), Box(self.low[:, None], self.high[:, None]))
        largest = np.maximum(np.abs(box.lower), np.abs(box.upper)).reshape(len(half), -1).T
        apart = box.distance(middle.T.reshape(-1, 1)).reshape(len(half), -1).T
        return middle, largest @ half, apart @ half

    def _defect_spread(self, known: Array) -> Array:
        """Return bounds (n,) of the differences of the defect from the known one (c, n) of its cell.

        On a piece of a window the defect differs from that in its middle by at most half its length times its rate.
        """
        c, pieces = self._factors(self.centre.factors, self.centre.factors), self._pieces
        middles = [self._chosen(cells.middles_of_pieces(self.blocks)) for cells in (self._path, self._jets)]
        defect = self._range(self.model.defect, *middles, c)[0]
        spread = defect.distance(self._tiled(known))
        if self._jets.verified:
            windows = [self._sampling(cells) for cells in (self._path, self._jets)]
            rate = self._range(self.model.defect, *windows, c)[1]
            spread += self._jets.reach(self.blocks) / pieces * np.maximum(np.abs(rate.lower), np.abs(rate.upper))
        return np.asarray(spread.max(axis=1))

    def spread(self, linear: LinearCells, tube: Array, unknown: Array) -> Spread | None:
        """Return the differences from the linear model in a tube (4n,); None if they cannot be enclosed."""
        c, f = self._factors(self.centre.factors, self.centre.factors), self._factors(self.low, self.high)
        S, z = linear.coordinates, Tube(linear.coordinates.S_inverse, tube)
        try:
            H, M = self._bounds(self.model.link_slope, self._windows(self._path), z, c, f)
            sampling = self._sampling(self._path), self._sampling(self._jets)
            (F,) = self._bounds(self.model.law_slope, *sampling, z, c)
        except ZeroDivisionError:
            return None
        G, B = self._bounds(self.model.motor_slope, f)
        count, inverse = self._jets.count, S.R @ np.tile(np.linalg.inv(linear.M)[self._at], (self._pieces, 1, 1))
        return Spread(
            unknown,
            H=self._largest(H, linear.H, S.torque, S.S_inverse),
            M=self._largest(M, linear.M, inverse, S.acceleration),
            G=self._largest(G, np.tile(linear.G, (count, 1, 1)), S.torque, S.S_inverse),
            B=self._largest(B, np.tile(linear.B, (count, 1, 1)), S.torque, S.effort_inverse),
            F=self._largest(F, linear.F, S.effort, S.S_inverse),
        )

    def storage(self, tube: Tube) -> float:
        """Return the largest V [J] of the law in a tube; nan if the law has none, inf if it cannot be enclosed."""
        k, centre = self._pieces * len(self._at), self._factors(self.centre.factors, self.centre.factors)
        middles = [self._chosen(cells.middles_of_pieces(self.blocks)) for cells in (self._path, self._jets)]
        if self._jets.verified:
            try:
                return self._storage_bound(middles, tube.box(k), centre)
            except ZeroDivisionError:
                return np.inf
        return self._sampled_storage(middles, tube, np.full((len(tube.radius), k), 0.5), centre)

    def _storage_bound(self, middles: list[Box], z: Box, c: Box) -> float:
        """Return the bound of V on all pieces of windows.

        V(z) <= V(0) + |dV/dz(0)| |z| + |z|' sup|d2V/dz2| |z| / 2 in the middle of a piece. On the piece, V differs from
        that by at most half its length times its rate.
        """
        windows = [self._sampling(cells) for cells in (self._path, self._jets)]
        zero, size = np.zeros(1), z.upper[:, 0]
        V, slope = enclosure(self.model.storage, *middles, Box.point(0 * z.upper), c)
        H = enclosure(self.model.storage_curvature, *middles, z, c)[0].distance(zero)
        rate = enclosure(self.model.storage_curvature, *windows, z, c)[1].distance(zero)
        in_middle = V.distance(zero) + size @ slope.distance(zero) + np.outer(size, size).ravel() @ H / 2
        return float(ROUNDING * np.max(in_middle + self._jets.reach(self.blocks) / self._pieces * rate))

    def _sampled_storage(self, middles: list[Box], tube: Tube, share: Array, c: Box) -> float:
        """Return V at the corners that the signs of dV/dz lead to in some steps: V is nearly quadratic in z."""
        found = []
        for _ in range(CLIMBS):
            V, slope = self._values(self.model.storage, *middles, Box.point(tube.corners(share)), c)
            found.append(V.max())
            share = np.where(tube.S_inverse.T @ slope > 0, 1.0, 0.0)
        return float(np.max(found))

    def _bounds(self, function: ca.Function, *arguments: Box | Tube) -> list[list[Box]]:
        """Return boxes of each output that together contain it: one if verified, else points."""
        k = self._pieces * len(self._at)
        if self._jets.verified:
            boxes = [each.box(k) if isinstance(each, Tube) else each for each in arguments]
            return [[box] for box in enclosure(function, *boxes)]
        return list(map(list, zip(*sampled_values(function, k, *arguments), strict=True)))

    def _largest(self, boxes: list[Box], middle: Array, left: Array, right: Array) -> Array:
        """Return the largest elements of |left (X - middle) right| for matrices X in boxes; middle: of the cells."""
        rows, columns = middle.shape[1:]
        flat = self._tiled(middle.transpose(0, 2, 1).reshape(len(middle), -1))
        if self._jets.verified:
            left, right = np.abs(left), np.abs(right)
        found = []
        for box in boxes:
            apart = box.distance(flat) if self._jets.verified else box.lower - flat
            found.append(np.abs(left @ apart.T.reshape(-1, columns, rows).swapaxes(1, 2) @ right).max(axis=0))
        return np.asarray(np.max(found, axis=0))

    @property
    def _jets(self) -> Cells:
        return self.centre.cells

    @cached_property
    def _path(self) -> Cells:
        return self.centre.path

    @property
    def _pieces(self) -> int:
        return PIECES[self._jets.verified]

    @cached_property
    def _at(self) -> Array:
        """Cells at which ranges are evaluated."""
        count = self._jets.count if self._jets.verified else min(SAMPLED, self._jets.count)
        return np.unique(np.linspace(0, self._jets.count - 1, count).round().astype(int))

    def _windows(self, cells: Cells, earlier: float = 0.0) -> Box:
        return self._chosen(cells.windows(self.blocks, earlier))

    def _sampling(self, cells: Cells) -> Box:
        return self._chosen(cells.sampling(self.blocks))

    def _chosen(self, windows: Box) -> Box:
        at = (self._jets.count * np.arange(self._pieces)[:, None] + self._at).ravel()
        return Box(windows.lower[:, at], windows.upper[:, at])

    def _factors(self, low: Array, high: Array) -> Box:
        return Box(*(np.tile(each[:, None], self._pieces * len(self._at)) for each in (low, high)))

    def _constant(self, factors: Array) -> Box:
        return Box.point(np.tile(factors[:, None], self._jets.count))

    def _tiled(self, known: Array) -> Array:
        """Return values (c, size) of the cells as columns of all pieces of the chosen cells."""
        return np.tile(known[self._at].T, self._pieces)

    def _range(self, function: ca.Function, *boxes: Box) -> list[Box]:
        return enclosure(function, *boxes) if self._jets.verified else sampled_range(function, *boxes)

    def _values(self, function: ca.Function, *points: Box) -> list[Array]:
        """Return the values of the outputs (size, k) at points (size, k)."""
        return [box.lower for box in sampled_range(function, *points)]
