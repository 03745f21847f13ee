# SPDX-License-Identifier: Apache-2.0
"""Ranges of errors and slopes over the windows of a centre motion, a tube about it and a box of factors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from fjr_core.errors import StateError
from fjr_core.numerics.casadi_function import columnwise
from fjr_core.numerics.checks import Array
from fjr_core.stability.linearization import split

from ..verification.taylor_models import Shape, TaylorModels, taylor_function
from .centre_motion import CentreMotion
from .deviation_model import FACTORS, DeviationModel
from .invariant_tube import Spread
from .matrix_models import MatrixModels
from .reference_cells import Cells, Window
from .sampled_deviation import LinearCells
from .steady_response import Drive
from .tube import INSTANTS, Tube, shares

SAMPLED = 24  # cells at which ranges that are not verified are evaluated
CLIMBS = 6  # corners of a tube that are tried for the largest V
INERTIA = FACTORS.index("motor_inertia")

Enclosure = list[TaylorModels]
"""Models that together contain an output of a function: one if verified, else points."""


@dataclass(frozen=True, eq=False)
class Ranges:
    """Ranges of the deviation model's functions about a centre motion, for factors from low to high (7,).

    They are found by Taylor models on verified cells, else at random corners. blocks: cells of the sums of the gains.
    delay [s].
    """

    model: DeviationModel
    centre: CentreMotion
    low: Array
    high: Array
    blocks: int
    delay: float

    def drive(self) -> Drive:
        """Return the known torques and efforts: of the centre motion, by each uncertain factor, by each torque term."""
        c, uncertain = self._tiled(self.centre.factors), self._half > 0
        defect, _ = columnwise(self.model.defect, self._path.instants, self._cells.instants, c)
        acting = self._cells.acting(self.blocks, self._whole)[0].middle
        _, rate = columnwise(self.model.defect, self._path.columns(acting), self._cells.columns(acting), c)
        slopes, _, second = self._coefficients
        by_factor = (self._terms @ (slopes * self._half))[:, :, uncertain]
        by_term = (self._terms * second)[:, :, second > 0]
        torque = _first_of_none(np.concatenate([by_factor, by_term], axis=2))
        aging = np.concatenate([np.zeros_like(rate), -rate / self.centre.factors[INERTIA]]).T
        effort = np.zeros((len(torque), self.model.n, torque.shape[2]))
        effort[:, :, 0] = defect.T
        return Drive(torque, aging, effort)

    def unknown(self, drive: Drive) -> Array:
        """Return bounds (4n,) of torques, accelerations and defects along the centre motion beside those of a drive."""
        n, age = self.model.n, self.delay + self._cells.sample_period
        (terms,) = self._enclosures(self.model.torque_terms, self._cells.windows(self.blocks))
        apart = self._apart(terms, self._terms.swapaxes(1, 2).reshape(self._cells.count, -1))
        torque = self._coefficients[1] @ apart.reshape(-1, 2 * n)
        acting, share = self._cells.acting(self.blocks, self._whole)
        rate = [each.mean_within(share) for each in self._enclosures(self.model.defect, acting)[1]]
        inertias = self.low[INERTIA], self.high[INERTIA]
        torque[n:] += age * np.max([self._apart(rate, -f * drive.aging[:, n:]) / f for f in inertias], axis=0)
        defect, _ = self._enclosures(self.model.defect, self._cells.sampling(self.blocks))
        return np.concatenate([torque, np.zeros(n), self._apart(defect, drive.effort[:, :, 0])])

    def spread(self, linear: LinearCells, tube: Array, unknown: Array, lines: Array) -> Spread | None:
        """Return the differences from the linear model; None if they cannot be enclosed.

        The deviation at the start of a cell is a sum of its `lines` (c, 4n, u), each times -1 to 1, and of one within
        the tube (4n,).
        """
        S, n, windows = linear.coordinates, self.model.n, self._cells.windows(self.blocks)
        z = Tube(S.S_inverse * tube, S.S_inverse @ lines)
        try:
            H, M = self._enclosures(self.model.link_slope, windows, z)
            (F,) = self._enclosures(self.model.law_slope, self._cells.sampling(self.blocks), z)
            G, B = self._enclosures(self.model.motor_slope, windows, z)
        except ZeroDivisionError:
            return None
        links = self._apart_of(H, linear.H, S.torque, S.S_inverse).on_path(z)
        motors = self._apart_of(G, self._stacked(linear.G), S.torque, S.S_inverse)
        efforts = self._apart_of(F, linear.F, S.effort, S.S_inverse).on_path(z)
        known = slice(z.directions.shape[1], None)
        beside = links.along(lines, known), motors.along(lines), np.zeros(n), efforts.along(lines, known)
        return Spread(
            unknown + np.concatenate(beside),
            H=links.largest,
            M=self._apart_of(M, linear.M, S.R @ np.linalg.inv(linear.M), S.acceleration).largest,
            G=motors.largest,
            B=self._apart_of(B, self._stacked(linear.B), S.torque, S.effort_inverse).largest,
            F=efforts.largest,
        )

    def second_order(self, linear: LinearCells, lines: Array) -> Drive:
        """Return the torques on the links and the efforts of second order in the factors, to which z follows `lines`.

        Its k columns are those of the products of two factors; the first, of none, is zero.
        """
        S, n = linear.coordinates, self.model.n
        z = Tube(np.zeros((4 * n, 0)), S.S_inverse @ lines)
        H, _ = self._enclosures(self.model.link_slope, self._cells.windows(self.blocks), z)
        (F,) = self._enclosures(self.model.law_slope, self._cells.sampling(self.blocks), z)
        one = np.eye(n)
        links, efforts = (
            self._apart_of(each, middle, one, S.S_inverse).on_path(z).products(lines)
            for each, middle in ((H, linear.H), (F, linear.F))
        )
        torque = np.concatenate([links, np.zeros_like(links)], axis=1)
        return Drive(_first_of_none(torque), np.zeros(torque.shape[:2]), _first_of_none(efforts))

    def storage(self, tube: Tube) -> float:
        """Return the largest V [J] of the law in a tube; nan if the law has none, inf if it cannot be enclosed."""
        if not self.model.has_storage:
            return np.nan
        if not self._cells.verified:
            return self._sampled_storage(tube)
        try:
            ((V,),) = self._enclosures(self.model.storage, self._cells.windows(self.blocks), tube)
        except (ZeroDivisionError, StateError):
            return np.inf
        return float(V.magnitude.max())

    def _sampled_storage(self, tube: Tube) -> float:
        """Return V at the corners that the signs of dV/dz lead to in some steps: V is nearly quadratic in z."""
        found = []
        arguments = self._along(self._cells.sampling(self.blocks))
        share: Array = np.full((tube.symbols, len(arguments["c"].T)), 0.5)
        for _ in range(CLIMBS):
            V, slope = _called(self.model.storage_slope, arguments | {"z": tube.corners(share)})
            found.append(V.max())
            share = np.where(tube.directions.T @ slope > 0, 1.0, 0.0)
        return float(np.max(found))

    @property
    def _whole(self) -> int:
        """Whole samples of the delay."""
        return split(self.delay, self._cells.sample_period)[0]

    @property
    def _half(self) -> Array:
        return (self.high - self.low) / 2

    @cached_property
    def _terms(self) -> Array:
        """Torque terms (c, 2n, 6) in the middle of the cells."""
        (terms,) = columnwise(self.model.torque_terms, self._path.middles, self._tiled(self.centre.factors))
        return np.asarray(terms.T.reshape(self._cells.count, -1, 2 * self.model.n).swapaxes(1, 2))

    @cached_property
    def _coefficients(self) -> tuple[Array, Array, Array]:
        """Derivatives (6, 7) of the coefficients of the torque terms, their largest values and second order (6,)."""
        c, half = self.centre.factors[:, None], self._half
        middle = self.model.coefficients(c, c).full()
        shape = Shape(np.count_nonzero(half), order=1, mixed=1)
        given = TaylorModels.exact(c, shape), TaylorModels.boxes(c, half[:, None], 0, shape)
        (models,) = taylor_function(self.model.coefficients)(*given)
        apart = models.minus(middle.T.reshape(-1, 1))
        largest, differences = (each.magnitude.reshape(len(half), -1).T for each in (models, apart))
        return middle, largest @ half, differences @ half

    def _enclosures(self, function: ca.Function, window: Window, tube: Tube | None = None) -> list[Enclosure]:
        """Return the ranges of each output in windows, a tube and the factors."""
        if self._cells.verified:
            return [[each] for each in taylor_function(function)(*self._models(function.name_in(), window, tube))]
        found = [
            [TaylorModels.exact(each) for each in _called(function, point)] for point in self._points(window, tube)
        ]
        return list(map(list, zip(*found, strict=True)))

    def _models(self, names: list[str], window: Window, tube: Tube | None) -> Iterator[TaylorModels]:
        """Return models of arguments in the time of a window, the deviations and the uncertain factors."""
        k, symbols = np.ones(len(window.middle)), 0
        if tube is not None:
            symbols = tube.symbols + np.count_nonzero(self._half)
        shape = Shape(symbols, order=2, mixed=1) if window.instant else Shape(symbols)
        for name in names:
            if name in ("path", "jets"):
                yield (self._path if name == "path" else self._cells).models(window, shape)
            elif name == "z" and tube is not None:
                yield TaylorModels.linear(tube.slopes, shape)
            elif name == "f" and tube is not None:
                half = np.outer(self._half, k)
                yield TaylorModels.boxes(np.outer(self.centre.factors, k), half, tube.symbols, shape)
            else:
                yield TaylorModels.exact(np.outer(self.centre.factors, k), shape)

    def _points(self, window: Window, tube: Tube | None) -> Iterator[dict[str, Array]]:
        """Yield arguments at three instants of windows: the middles and random corners of tube and factors."""
        along = self._along(window)
        if tube is None:
            yield along
            return
        size, k = tube.symbols, len(along["c"].T)
        for share in shares(size + len(FACTORS), k):
            f = self.low[:, None] + share[size:] * 2 * self._half[:, None]
            yield along | {"z": tube.corners(share[:size]), "f": f}

    def _along(self, window: Window) -> dict[str, Array]:
        """Return the arguments along the centre motion at three instants of the sampled windows."""
        t = (window.middle[self._at] + window.radius * np.array(INSTANTS)[:, None]).ravel()
        c = np.repeat(self.centre.factors[:, None], len(t), axis=1)
        return {"path": self._path.columns(t), "jets": self._cells.columns(t), "c": c}

    def _apart(self, enclosure: Enclosure, known: Array) -> Array:
        """Return the largest distances (size,) of an output from known values (c, size) of the cells."""
        return np.asarray(np.max([each.minus(self._chosen(known).T).magnitude for each in enclosure], axis=(0, 2)))

    def _apart_of(self, enclosure: Enclosure, middle: Array, left: Array, right: Array) -> MatrixModels:
        """Return left (X - middle) right for matrices X; left, middle: of the cells (c, ..), or of all.

        The signs of a model's coefficients are kept, so that X acts on the coordinates, not on the joints.
        """
        rows, columns = middle.shape[1:]
        known = self._chosen(middle.transpose(0, 2, 1).reshape(len(middle), -1)).T
        left = self._chosen(left)[:, None] if left.ndim == 3 else left
        found = []
        for each in enclosure:
            apart = each.minus(known)
            matrices = apart.values.reshape(len(apart.values), columns, rows, -1).transpose(0, 3, 2, 1)
            found.append(MatrixModels(matrices, apart.shape).between(left, right).values)
        return MatrixModels(np.concatenate(found), enclosure[0].shape)

    @property
    def _cells(self) -> Cells:
        return self.centre.cells

    @cached_property
    def _path(self) -> Cells:
        return self.centre.path

    @cached_property
    def _at(self) -> Array:
        """Cells at which ranges are evaluated."""
        count = self._cells.count if self._cells.verified else min(SAMPLED, self._cells.count)
        return np.unique(np.linspace(0, self._cells.count - 1, count).round().astype(int))

    def _chosen(self, of_cells: Array) -> Array:
        """Return values (c, ..) of the cells at the instants of the ranges."""
        return of_cells if self._cells.verified else np.concatenate([of_cells[self._at]] * len(INSTANTS))

    def _stacked(self, matrix: Array) -> Array:
        return np.asarray(np.broadcast_to(matrix, (self._cells.count, *matrix.shape)))

    def _tiled(self, factors: Array) -> Array:
        return np.repeat(factors[:, None], self._cells.count, axis=1)


def _first_of_none(columns: Array) -> Array:
    """Return columns (c, rows, k) after a first one of zeros."""
    return np.concatenate([np.zeros((*columns.shape[:2], 1)), columns], axis=2)


def _called(function: ca.Function, arguments: dict[str, Array]) -> list[Array]:
    return columnwise(function, *(arguments[name] for name in function.name_in()))
