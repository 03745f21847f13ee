# SPDX-License-Identifier: Apache-2.0
"""Ranges of errors and slopes over the windows of a centre motion, a tube about it and a box of factors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import reduce
from os import cpu_count
from typing import NamedTuple, TypeVar

import casadi as ca
import numpy as np
from scipy.linalg import block_diag

from fjr_core.errors import StateError
from fjr_core.law.linearized import Indices
from fjr_core.numerics.checks import Array
from fjr_core.stability.linearization import split

from ..verification.taylor_models import ROUNDING, MatrixModels, Shape, TaylorModels, taylor_function
from .cells import CellTimes
from .known_response import KnownErrors
from .linear_loop import LinearLoop, columnwise

SAMPLED = 24  # cells at which ranges that are not verified are evaluated
POINTS = 4  # of tube and factors at each instant: their middle, and random corners
INSTANTS = (-1.0, 0.0, 1.0)  # of a window, relative to its radius
SEED = 0
IN_CACHE = 5_000  # cells times cubed joints, to which the size of their models is proportional
CLIMBS = 6  # corners of a tube that are tried for the largest V

Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class Tube:
    """Deviations z and factors f in c cells: sums of columns, each times -1 to 1.

    directions (4n, m): of z. lines (c, 4n + u, u): of z and of what f differs from the middle of their box.
    """

    directions: Array
    lines: Array

    @property
    def symbols(self) -> int:
        """Number m + u of symbols of a model."""
        return self.directions.shape[1] + self.lines.shape[2]

    @property
    def columns(self) -> Array:
        """All columns (c, 4n + u, m + u), the directions first."""
        below = np.zeros((self.lines.shape[1] - len(self.directions), self.directions.shape[1]))
        directions = np.concatenate([self.directions, below])
        return np.concatenate([np.broadcast_to(directions, (len(self.lines), *directions.shape)), self.lines], axis=2)


class Mismatch(NamedTuple):
    """Bounds over all cells, tube and factors of the differences of a robot from the linear model.

    unknown (4n,): torque errors d_l, d_m, d_s and defects of the law along the centre motion and the lines, beside the
    known ones. X (3n, 4n), M (n, n), B (n, n), F (n, 4n): largest differences of the slopes of torques in z, of the
    inertia, of the input of the effort and of the law from those of the model, elementwise. All in the coordinates of
    the linear model.
    """

    unknown: Array
    X: Array
    M: Array
    B: Array
    F: Array

    def most(self, other: Mismatch) -> Mismatch:
        """Return the larger bounds of two."""
        return Mismatch(*map(np.maximum, self, other))


class Ranges:
    """Ranges of the deviation model's functions about a centre motion, for shares of the factors from low to high (u,).

    They are found by Taylor models on verified cells, all or those `at`, else at random corners. linear: model about
    the centre motion. blocks: cells of the sums of the gains.
    """

    def __init__(self, linear: LinearLoop, low: Array, high: Array, blocks: int, at: Indices | None = None) -> None:
        self.linear, self.low, self.high, self.blocks = linear, low, high, blocks
        self._half: Array = (high - low) / 2
        self._model, self._cells, self._path = linear.model, linear.centre.cells, linear.centre.path
        self._whole = split(linear.delay, linear.sample_period)[0]  # samples of the delay
        if at is None:
            count = self._cells.count if self._cells.verified else min(SAMPLED, self._cells.count)
            at = np.unique(np.linspace(0, self._cells.count - 1, count).round().astype(int))
        self.at = at

    @property
    def factors(self) -> int:
        """Number u of uncertain factors."""
        return len(self.low)

    def of(self, at: Indices) -> Ranges:
        """Return the ranges in other cells."""
        return Ranges(self.linear, self.low, self.high, self.blocks, at)

    def known_errors(self) -> KnownErrors:
        """Return known torques and efforts: of the centre motion, and by each uncertain factor."""
        cells, linear = self._cells, self.linear
        c = np.repeat(linear.centre.factors[:, None], cells.count, axis=1)
        defect, _ = columnwise(self._model.defect, self._path.columns(cells.sampled), cells.columns(cells.sampled), c)
        acting = cells.acting(self.blocks, self._whole)[0].middle
        _, rate = columnwise(self._model.defect, self._path.columns(acting), cells.columns(acting), c)
        torque = np.pad(linear.factors * self._half, ((0, 0), (0, 0), (1, 0)))
        (inertia,) = self._inertias(linear.centre.factors)
        aging = np.concatenate([0 * rate, -rate / inertia[:, None], 0 * rate]).T
        effort = np.zeros((len(torque), linear.n, torque.shape[2]))
        effort[:, :, 0] = defect.T
        return KnownErrors(torque, aging, effort)

    def unknown_errors(self, known: KnownErrors) -> Array:
        """Return bounds (4n,) of torques and defects along the centre motion beside the known ones.

        With a delay that varies the torques (n,) of the change of the effort in a sample precede the defects.
        """
        n, age = self.linear.n, self.linear.delay + self._cells.sample_period
        torque = np.zeros(3 * n)
        acting, share = self._cells.acting(self.blocks, self._whole)
        rates = self._range(self._model.defect, acting)[1]
        rate = rates.mean_within(share)
        inertias = self._inertias(self.low, self.high)
        torque[n : 2 * n] = age * np.max(
            [self._apart(rate, -f * known.aging[:, n : 2 * n]) / f for f in inertias], axis=0
        )
        defect, _ = self._range(self._model.defect, self._cells.sampling(self.blocks))
        largest = self._cells.sample_period * rates.magnitude.max(axis=1)
        late = [largest / np.minimum(*inertias)] if self.linear.late else []
        return np.concatenate([torque, *late, self._apart(defect, known.effort[:, :, 0])])

    def mismatch(
        self, bounds: Array, unknown: Array, lines: Array, accelerations: Array, anywhere: Array | None = None
    ) -> Mismatch | None:
        """Return the differences from the linear model; None if they cannot be enclosed.

        The deviation at the start of a cell is a sum of its `lines` (c, 4n, u), each times -1 to 1, and of one within
        the bounds (4n,); that of the acceleration is a sum of `accelerations` (c, n, u) and of one that is bounded
        elsewhere. The slopes are the means on the way from zero to it. With bounds (n,) of the acceleration they are
        those `anywhere` in the tube: of the difference of two motions, since M_l a_1 - M_l' a_2 = M_l (a_1 - a_2) +
        (M_l - M_l') a_2.
        """
        n, directions, B = self.linear.n, self.linear.coordinates.S_inverse * bounds, self._input_apart()
        known, others = slice(directions.shape[1], None), np.zeros(len(unknown) - 4 * n)

        def of_cells(part: Ranges, cells: slice) -> Mismatch:
            torques, M, efforts = part._slopes(part.tube(directions, lines[cells]), anywhere)
            whole = np.concatenate([_with_factors(lines[cells]), accelerations[cells]], axis=1)
            along = torques.beside(M).along(whole, known), others, efforts.along(lines[cells], known)
            above = unknown if anywhere is not None else unknown + np.concatenate(along)
            return Mismatch(above, torques.largest[:, : 4 * n], M.largest, B, efforts.largest)

        try:
            return reduce(Mismatch.most, self._in_parts(of_cells))
        except ZeroDivisionError:
            return None

    def _in_parts(self, found: Callable[[Ranges, slice], Found]) -> list[Found]:
        """Return what is found in consecutive cells, whose models are together in the cache of a processor."""
        if not self._cells.verified:
            return [found(self, slice(1))]  # lines are zero
        processors = cpu_count() or 1
        count = min(1 + IN_CACHE // self.linear.n**3, 1 + len(self.at) // processors)
        parts = [slice(first, first + count) for first in range(0, len(self.at), count)]
        with ThreadPoolExecutor(processors) as pool:
            return list(pool.map(found, [self.of(self.at[cells]) for cells in parts], parts))

    def of_factors(self, disturbances: int, lines: Array) -> Iterator[Mismatch]:
        """Yield what each factor alone contributes to the differences from the linear model along the lines."""
        n, slopes = self.linear.n, self._slopes(self.tube(np.zeros((4 * self.linear.n, 0)), lines))
        for symbol in range(1, 1 + self.factors):
            X, M, F = (models.of(symbol).largest for models in slopes)
            yield Mismatch(np.zeros(disturbances), X[:, : 4 * n], M, np.zeros((n, n)), F)

    def second_order(self, lines: Array, accelerations: Array) -> KnownErrors:
        """Return the errors of second order along lines that z follows.

        Their columns are those of the lines, then the further ones of `_of_pairs`.
        """
        to_joints, S, none = np.linalg.inv, self.linear.coordinates, np.zeros((4 * self.linear.n, 0))

        def of_cells(part: Ranges, cells: slice) -> tuple[Array, Array]:
            torques, M, efforts = part._slopes(part.tube(none, lines[cells]))
            whole = np.concatenate([_with_factors(lines[cells]), accelerations[cells]], axis=1)
            torque, effort = torques.beside(M).products(whole), efforts.products(lines[cells])
            return to_joints(S.torques) @ _of_pairs(torque), to_joints(S.effort) @ _of_pairs(effort)

        torques, efforts = map(np.concatenate, zip(*self._in_parts(of_cells), strict=True))
        return KnownErrors(torques, np.zeros(torques.shape[:2]), efforts)

    def storage(self, tube: Tube) -> float:
        """Return the largest V [J] of the law in a tube; nan if the law has none, inf if it cannot be enclosed."""
        if not self._model.has_storage:
            return np.nan
        if not self._cells.verified:
            return self._sampled_storage(tube)
        try:
            (V,) = self._range(self._model.storage, self._cells.windows(self.blocks), tube)
        except (ZeroDivisionError, StateError):
            return np.inf
        return float(V.magnitude.max())

    def _sampled_storage(self, tube: Tube) -> float:
        """Return V at the corners that the signs of dV/dz lead to in some steps: V is nearly quadratic in z."""
        largest, arguments = -np.inf, self._along(self._cells.sampling(self.blocks))
        directions = tube.directions
        signs: Array = np.zeros((directions.shape[1], len(arguments["c"].T)))
        for _ in range(CLIMBS):
            V, slope = _called(self._model.storage_slope, arguments | {"z": directions @ signs})
            largest = max(largest, float(V.max()))
            signs = np.where(directions.T @ slope > 0, 1.0, -1.0)
        return largest

    def tube(self, directions: Array, lines: Array) -> Tube:
        """Return the tube of directions (4n, m), and of lines (c, 4n, u) in the coordinates of the linear model."""
        right = block_diag(self.linear.coordinates.S_inverse, np.diag(self._half))
        return Tube(directions, right @ _with_factors(lines))

    def _slopes(self, tube: Tube, anywhere: Array | None = None) -> tuple[MatrixModels, MatrixModels, MatrixModels]:
        """Return the differences of slopes of torques (3n, 4n + u), inertia (n, n) and law (n, 4n) from the model."""
        linear, S = self.linear, self.linear.coordinates
        X, M = self._range(self._model.slopes, self._cells.windows(self.blocks), tube, anywhere)
        (F,) = self._range(self._model.law_slope, self._cells.sampling(self.blocks), tube)
        slopes = np.concatenate([linear.H, linear.G, 0 * linear.H], axis=1)
        middle = np.concatenate([slopes, linear.factors], axis=2)
        torques = self._matrices_apart(X, middle, S.torques, block_diag(S.S_inverse, np.diag(self._half)))
        efforts = self._matrices_apart(F, linear.F, S.effort, S.S_inverse)
        if anywhere is None:
            torques, efforts = torques.mean_from_zero(), efforts.mean_from_zero()
        return torques, self._matrices_apart(M, linear.M, S.torque, S.acceleration), efforts

    def _input_apart(self) -> Array:
        """Return the largest differences (n, n) of the input of the effort from the model."""
        linear, S = self.linear, self.linear.coordinates
        low, middle, high = self._inertias(self.low, linear.centre.factors, self.high)
        apart = ROUNDING * np.maximum(np.abs(1 / low - 1 / middle), np.abs(1 / high - 1 / middle))
        return np.asarray(np.abs(S.torque) * apart @ np.abs(self._model.robot.B_m @ S.effort_inverse))

    def _inertias(self, *shares: Array) -> list[Array]:
        """Return the factors (n,) of the motor inertias at shares (u,)."""
        return [self._model.uncertain.of_joints("motor_inertia", each) for each in shares]

    def _range(
        self, function: ca.Function, window: CellTimes, tube: Tube | None = None, acceleration: Array | None = None
    ) -> list[TaylorModels]:
        """Return models of each output in windows, a tube, deviations of the acceleration and the factors.

        Those of sampled cells are its values at points.
        """
        if self._cells.verified:
            return taylor_function(function)(*self._models(function.name_in(), window, tube, acceleration))
        return [TaylorModels.exact(y) for y in _called(function, self._points(window, tube))]

    def _models(
        self, names: list[str], window: CellTimes, tube: Tube | None, acceleration: Array | None
    ) -> Iterator[TaylorModels]:
        """Return models of arguments in the time of a window, the deviations and the uncertain factors."""
        n, symbols, window = self.linear.n, 0 if tube is None else tube.symbols, window.of(self.at)
        shape = Shape(symbols, order=2, mixed=1) if window.instant else Shape(symbols)
        c = np.outer(self.linear.centre.factors, np.ones(len(window.middle)))
        for name in names:
            if name in ("path", "jets"):
                models = (self._path if name == "path" else self._cells).models(window, shape)
                if name == "path" and acceleration is not None:
                    models.values[:, 2 * n : 3 * n, -1] += acceleration
                yield models
            elif name == "motors":
                in_time = shape._replace(symbols=0)
                path = self._path.models(window, in_time)
                (models,) = taylor_function(self._model.motors)(path, TaylorModels.exact(c, in_time))
                yield models.among(shape)
            elif name in ("z", "f") and tube is not None:
                rows = tube.columns[:, : 4 * n] if name == "z" else tube.columns[:, 4 * n :]
                models = TaylorModels.linear(rows.transpose(1, 2, 0), shape)
                yield models if name == "z" else models.minus(np.negative(c))
            else:
                yield TaylorModels.exact(c, shape)

    def _points(self, window: CellTimes, tube: Tube | None) -> dict[str, Array]:
        """Return arguments at three instants of windows: the middles and random corners of tube and factors."""
        along = self._along(window)
        if tube is None:
            return along
        size = tube.symbols, along["c"].shape[1]
        corners = np.random.default_rng(SEED).choice([-1.0, 1.0], (POINTS - 1, *size))
        signs = np.concatenate([np.zeros(size), *corners], axis=1)
        z, f = np.split(tube.columns[0] @ signs, [4 * self.linear.n])
        along = {name: np.tile(values, POINTS) for name, values in along.items()}
        return along | {"z": z, "f": along["c"] + f}

    def _along(self, window: CellTimes) -> dict[str, Array]:
        """Return the arguments along the centre motion at three instants of the sampled windows."""
        t = (window.of(self.at).middle + window.radius * np.array(INSTANTS)[:, None]).ravel()
        c, path = np.repeat(self.linear.centre.factors[:, None], len(t), axis=1), self._path.columns(t)
        (motors,) = columnwise(self._model.motors, path, c)
        return {"path": path, "motors": motors, "jets": self._cells.columns(t), "c": c}

    def _apart(self, models: TaylorModels, known: Array) -> Array:
        """Return the largest distances (size,) of an output from known values (c, size) of the cells."""
        return np.asarray(models.minus(self._at_points(known, models).T).magnitude.max(axis=1))

    def _matrices_apart(self, models: TaylorModels, middle: Array, left: Array, right: Array) -> MatrixModels:
        """Return left (X - middle) right for matrices X; left, middle: of the cells (c, ..), or left of all.

        The signs of a model's coefficients are kept, so that X acts on the coordinates, not on the joints.
        """
        rows, columns = middle.shape[1:]
        known = self._at_points(middle.transpose(0, 2, 1).reshape(len(middle), -1), models).T
        left = self._at_points(left, models) if left.ndim == 3 else left
        apart = models.minus(known).values
        return MatrixModels(apart.reshape(len(apart), columns, rows, -1), models.shape).between(left, right)

    def _at_points(self, of_cells: Array, models: TaylorModels) -> Array:
        """Return values (c, ..) of the cells for each model: the cells are in the same order at all points."""
        return np.concatenate([of_cells[self.at]] * (len(models.values) // len(self.at)))


def _with_factors(lines: Array) -> Array:
    """Return lines (c, 4n + u, 1 + u) of deviations and of the factors, which all but the first follow."""
    c, _, columns = lines.shape
    factors = np.eye(columns - 1, columns, 1)
    return np.concatenate([lines, np.broadcast_to(factors, (c, *factors.shape))], axis=1)


def _of_pairs(products: Array) -> Array:
    """Return products (c, rows, 1 + u, 1 + u) of a known line and of u factors as columns (c, rows, 1 + u + k).

    The first is known, u follow the factors, the others are times -1 to 1: the square of a factor is 1/2 +- 1/2.
    """
    pairs = products + products.swapaxes(2, 3)
    i, j = np.triu_indices(products.shape[2] - 1, 1)
    squares, mixed = np.diagonal(products, axis1=2, axis2=3)[:, :, 1:] / 2, pairs[:, :, i + 1, j + 1]
    known = products[:, :, :1, 0] + squares.sum(axis=2, keepdims=True)
    return np.concatenate([known, pairs[:, :, 0, 1:], squares, mixed], axis=2)


def _called(function: ca.Function, arguments: dict[str, Array]) -> list[Array]:
    return columnwise(function, *(arguments[name] for name in function.name_in()))
