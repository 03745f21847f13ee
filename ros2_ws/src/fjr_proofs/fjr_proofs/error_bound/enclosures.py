# SPDX-License-Identifier: Apache-2.0
"""Ranges of errors and slopes over the windows of a centre motion, a tube about it and a box of factors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from fjr_core.errors import StateError
from fjr_core.numerics.checks import Array
from fjr_core.stability.linearization import split

from ..verification.taylor_models import Shape, TaylorModels, taylor_function
from .cells import CellTimes
from .deviation_model import FACTORS
from .linear_loop import KnownErrors, LinearLoop
from .peak_gains import ROUNDING, columnwise

SAMPLED = 24  # cells at which ranges that are not verified are evaluated
POINTS = 4  # of tube and factors at each instant: their middle, and random corners
INSTANTS = (-1.0, 0.0, 1.0)  # of a window, relative to its radius
SEED = 0
CLIMBS = 6  # corners of a tube that are tried for the largest V
PRODUCTS = 1e-13  # relative error of two products of matrices of up to 4n rows
INERTIA = FACTORS.index("motor_inertia")

Enclosure = list[TaylorModels]
"""Models that together contain an output of a function: one if verified, else points."""


@dataclass(frozen=True, eq=False)
class Tube:
    """Deviations z (4n,) in c cells: sums of `directions` (4n, m) and of `lines` (c, 4n, u), each times -1 to 1."""

    directions: Array
    lines: Array

    @property
    def symbols(self) -> int:
        """Number m + u of symbols of a model."""
        return self.directions.shape[1] + self.lines.shape[2]

    @property
    def box(self) -> Array:
        """Bounds (4n,) of |z|."""
        return np.asarray(np.abs(self.directions).sum(axis=1) + np.abs(self.lines).sum(axis=2).max(axis=0))

    def corners(self, share: Array) -> Array:
        """Return points (4n, k) of a tube without lines at shares (m, k) of its width."""
        return np.asarray(self.directions @ (2 * share - 1))


@dataclass(frozen=True, eq=False)
class MatrixModels:
    """Models of matrices X in k boxes: values (k, shape.width, rows, columns); the last are bounds of the rest."""

    values: Array
    shape: Shape

    def between(self, left: Array, right: Array) -> MatrixModels:
        """Return left X right. The signs of all coefficients are kept."""
        exact, rest = self.values[:, :-1], self.values[:, -1:]
        rest = rest + PRODUCTS * np.abs(exact).sum(axis=1, keepdims=True)
        values = np.concatenate([left @ exact @ right, np.abs(left) @ rest @ np.abs(right)], axis=1)
        return MatrixModels(values, self.shape)

    def mean_from_zero(self, tube: Tube) -> MatrixModels:
        """Return models of the mean of X on the way from 0 to a deviation in the tube: its terms grow in proportion."""
        values = self.values.copy()
        if self.shape.symbols:
            values[:, self.shape.order : self.shape.order + tube.symbols] /= 2
        return MatrixModels(values, self.shape)

    @property
    def largest(self) -> Array:
        """Largest elements (rows, columns) of |X|."""
        return np.asarray(ROUNDING * np.abs(self.values).sum(axis=1).max(axis=0))

    def along(self, lines: Array, known: slice = slice(0)) -> Array:
        """Return the largest elements (rows,) of X times a sum of lines (k, columns, u), each times -1 to 1.

        known: symbols whose products with the lines are left out, as `products` returns them.
        """
        if not lines.shape[2]:
            return np.zeros(self.values.shape[2])
        unknown = np.delete(self.values[:, :-1], self._places(known), axis=1)
        signed = np.abs(unknown @ lines[:, None]).sum(axis=(1, 3))
        return np.asarray(ROUNDING * (signed + (self.values[:, -1] @ np.abs(lines)).sum(axis=2)).max(axis=0))

    def products(self, lines: Array) -> Array:
        """Return the products (k, rows, symbols u) of the slopes of X in its symbols and the lines."""
        products = self.values[:, self._places(slice(None))] @ lines[:, None]
        return np.asarray(products.transpose(0, 2, 1, 3).reshape(len(products), products.shape[2], -1))

    def _places(self, symbols: slice) -> slice:
        """Return the places of the slopes in these symbols."""
        first, last, _ = symbols.indices(self.shape.symbols)
        return slice(self.shape.order + first, self.shape.order + last)


@dataclass(frozen=True, eq=False)
class Mismatch:
    """Bounds over all cells, tube and factors of the differences of a robot from the linear model.

    unknown (4n,): torque errors d_l, d_m, accelerations (none) and defects of the law along the centre motion and the
    lines, beside the known ones. H (n, 4n), G (n, 4n), B (n, n), F (n, 4n): largest differences of the slopes from
    those of the model, elementwise. M (n, n): of M_i^-1 M_l(q_l) from the identity. All in the coordinates of the
    linear model.
    """

    unknown: Array
    H: Array
    M: Array
    G: Array
    B: Array
    F: Array


class Ranges:
    """Ranges of the deviation model's functions about a centre motion, for factors from low to high (7,).

    They are found by Taylor models on verified cells, else at random corners. linear: model about the centre motion.
    blocks: cells of the sums of the gains.
    """

    def __init__(self, linear: LinearLoop, low: Array, high: Array, blocks: int) -> None:
        self.linear, self.low, self.high, self.blocks = linear, low, high, blocks
        self._half: Array = (high - low) / 2
        self._model, self._cells, self._path = linear.model, linear.centre.cells, linear.centre.path
        self._whole = split(linear.delay, linear.sample_period)[0]  # samples of the delay
        count = self._cells.count if self._cells.verified else min(SAMPLED, self._cells.count)
        self._at = np.unique(np.linspace(0, self._cells.count - 1, count).round().astype(int))  # cells of the ranges

    def known_errors(self) -> KnownErrors:
        """Return known torques and efforts: of the centre motion, by each uncertain factor, by each torque term."""
        cells, uncertain = self._cells, self._half > 0
        c = np.repeat(self.linear.centre.factors[:, None], cells.count, axis=1)
        defect, _ = columnwise(self._model.defect, self._path.columns(cells.sampled), cells.columns(cells.sampled), c)
        acting = cells.acting(self.blocks, self._whole)[0].middle
        _, rate = columnwise(self._model.defect, self._path.columns(acting), cells.columns(acting), c)
        slopes, _, second = self._coefficients
        by_factor = (self._terms @ (slopes * self._half))[:, :, uncertain]
        by_term = (self._terms * second)[:, :, second > 0]
        torque = _after_zeros(np.concatenate([by_factor, by_term], axis=2))
        aging = np.concatenate([np.zeros_like(rate), -rate / self.linear.centre.factors[INERTIA]]).T
        effort = np.zeros((len(torque), self.linear.n, torque.shape[2]))
        effort[:, :, 0] = defect.T
        return KnownErrors(torque, aging, effort)

    def unknown_errors(self, known: KnownErrors) -> Array:
        """Return bounds (4n,) of torques, accelerations and defects along the centre motion beside the known ones.

        With a delay that varies the torques (n,) of the change of the effort in a sample precede the defects.
        """
        n, age = self.linear.n, self.linear.delay + self._cells.sample_period
        (terms,) = self._range(self._model.torque_terms, self._cells.windows(self.blocks))
        apart = self._apart(terms, self._terms.swapaxes(1, 2).reshape(self._cells.count, -1))
        torque = self._coefficients[1] @ apart.reshape(-1, 2 * n)
        acting, share = self._cells.acting(self.blocks, self._whole)
        rates = self._range(self._model.defect, acting)[1]
        rate = [models.mean_within(share) for models in rates]
        inertias = self.low[INERTIA], self.high[INERTIA]
        torque[n:] += age * np.max([self._apart(rate, -f * known.aging[:, n:]) / f for f in inertias], axis=0)
        defect, _ = self._range(self._model.defect, self._cells.sampling(self.blocks))
        changes = [self._cells.sample_period / inertias[0] * np.max([m.magnitude.max(axis=1) for m in rates], axis=0)]
        late = changes if self.linear.late else []
        return np.concatenate([torque, np.zeros(n), *late, self._apart(defect, known.effort[:, :, 0])])

    def mismatch(
        self, bounds: Array, unknown: Array, lines: Array, acceleration: Array | None = None
    ) -> Mismatch | None:
        """Return the differences from the linear model; None if they cannot be enclosed.

        The deviation at the start of a cell is a sum of its `lines` (c, 4n, u), each times -1 to 1, and of one within
        the bounds (4n,). The slopes are the means on the way from zero to it. With bounds of the acceleration (n,) they
        are those anywhere in the tube: of the difference of two motions, since M_l a_1 - M_l' a_2 = M_l (a_1 - a_2) +
        (M_l - M_l') a_2.
        """
        linear, n, windows = self.linear, self.linear.n, self._cells.windows(self.blocks)
        S = linear.coordinates
        z = Tube(S.S_inverse * bounds, S.S_inverse @ lines)
        G_middle, B_middle = (np.broadcast_to(X, (self._cells.count, *X.shape)) for X in (linear.G, linear.B))
        try:
            H, M = self._range(self._model.link_slope, windows, z, acceleration)
            (F,) = self._range(self._model.law_slope, self._cells.sampling(self.blocks), z)
            G, B = self._range(self._model.motor_slope, windows, z)
        except ZeroDivisionError:
            return None
        links = self._matrices_apart(H, linear.H, S.torque, S.S_inverse)
        motors = self._matrices_apart(G, G_middle, S.torque, S.S_inverse)
        efforts = self._matrices_apart(F, linear.F, S.effort, S.S_inverse)
        if acceleration is None:
            links, efforts = links.mean_from_zero(z), efforts.mean_from_zero(z)
        known = slice(z.directions.shape[1], None)
        others = np.zeros(len(unknown) - 3 * n)
        along_lines = links.along(lines, known), motors.along(lines), others, efforts.along(lines, known)
        return Mismatch(
            unknown + np.concatenate(along_lines),
            H=links.largest,
            M=self._matrices_apart(M, linear.M, S.R @ np.linalg.inv(linear.M), S.acceleration).largest,
            G=motors.largest,
            B=self._matrices_apart(B, B_middle, S.torque, S.effort_inverse).largest,
            F=efforts.largest,
        )

    def second_order(self, lines: Array) -> KnownErrors:
        """Return the torques on the links and the efforts of second order in the factors, to which z follows `lines`.

        Its k columns are those of the products of two factors; the first, of none, is zero.
        """
        linear, n, S = self.linear, self.linear.n, self.linear.coordinates
        z = Tube(np.zeros((4 * n, 0)), S.S_inverse @ lines)
        H, _ = self._range(self._model.link_slope, self._cells.windows(self.blocks), z)
        (F,) = self._range(self._model.law_slope, self._cells.sampling(self.blocks), z)
        links, efforts = (
            self._matrices_apart(X, middle, np.eye(n), S.S_inverse).mean_from_zero(z).products(lines)
            for X, middle in ((H, linear.H), (F, linear.F))
        )
        torque = np.concatenate([links, np.zeros_like(links)], axis=1)
        return KnownErrors(_after_zeros(torque), np.zeros(torque.shape[:2]), _after_zeros(efforts))

    def storage(self, tube: Tube) -> float:
        """Return the largest V [J] of the law in a tube; nan if the law has none, inf if it cannot be enclosed."""
        if not self._model.has_storage:
            return np.nan
        if not self._cells.verified:
            return self._sampled_storage(tube)
        try:
            ((V,),) = self._range(self._model.storage, self._cells.windows(self.blocks), tube)
        except (ZeroDivisionError, StateError):
            return np.inf
        return float(V.magnitude.max())

    def _sampled_storage(self, tube: Tube) -> float:
        """Return V at the corners that the signs of dV/dz lead to in some steps: V is nearly quadratic in z."""
        largest, arguments = -np.inf, self._along(self._cells.sampling(self.blocks))
        share: Array = np.full((tube.symbols, len(arguments["c"].T)), 0.5)
        for _ in range(CLIMBS):
            V, slope = _called(self._model.storage_slope, arguments | {"z": tube.corners(share)})
            largest = max(largest, float(V.max()))
            share = np.where(tube.directions.T @ slope > 0, 1.0, 0.0)
        return largest

    @cached_property
    def _terms(self) -> Array:
        """Torque terms (c, 2n, 6) in the middle of the cells."""
        factors = np.repeat(self.linear.centre.factors[:, None], self._cells.count, axis=1)
        (terms,) = columnwise(self._model.torque_terms, self._path.columns(self._cells.middle), factors)
        return np.asarray(terms.T.reshape(self._cells.count, -1, 2 * self.linear.n).swapaxes(1, 2))

    @cached_property
    def _coefficients(self) -> tuple[Array, Array, Array]:
        """Derivatives (6, 7) of the coefficients of the torque terms, their largest values and second order (6,)."""
        c, half = self.linear.centre.factors[:, None], self._half
        middle = self._model.coefficients(c, c).full()
        shape = Shape(np.count_nonzero(half), order=1, mixed=1)
        factors = TaylorModels.exact(c, shape), TaylorModels.boxes(c, half[:, None], 0, shape)
        (models,) = taylor_function(self._model.coefficients)(*factors)
        apart = models.minus(middle.T.reshape(-1, 1))
        largest, differences = (X.magnitude.reshape(len(half), -1).T for X in (models, apart))
        return middle, largest @ half, differences @ half

    def _range(
        self, function: ca.Function, window: CellTimes, tube: Tube | None = None, acceleration: Array | None = None
    ) -> list[Enclosure]:
        """Return the ranges of each output in windows, a tube, deviations of the acceleration and the factors."""
        if self._cells.verified:
            results = taylor_function(function)(*self._models(function.name_in(), window, tube, acceleration))
            return [[models] for models in results]
        points = [[TaylorModels.exact(y) for y in _called(function, point)] for point in self._points(window, tube)]
        return list(map(list, zip(*points, strict=True)))

    def _models(
        self, names: list[str], window: CellTimes, tube: Tube | None, acceleration: Array | None
    ) -> Iterator[TaylorModels]:
        """Return models of arguments in the time of a window, the deviations and the uncertain factors."""
        k, symbols = np.ones(len(window.middle)), 0
        if tube is not None:
            symbols = tube.symbols + np.count_nonzero(self._half)
        shape = Shape(symbols, order=2, mixed=1) if window.instant else Shape(symbols)
        for name in names:
            if name in ("path", "jets"):
                models = (self._path if name == "path" else self._cells).models(window, shape)
                if name == "path" and acceleration is not None:
                    models.values[:, 2 * self.linear.n : 3 * self.linear.n, -1] += acceleration
                yield models
            elif name == "z" and tube is not None:
                directions = np.broadcast_to(tube.directions, (len(tube.lines), *tube.directions.shape))
                slopes = np.concatenate([directions, tube.lines], axis=2)
                yield TaylorModels.linear(slopes.transpose(1, 2, 0), shape)
            elif name == "f" and tube is not None:
                half = np.outer(self._half, k)
                yield TaylorModels.boxes(np.outer(self.linear.centre.factors, k), half, tube.symbols, shape)
            else:
                yield TaylorModels.exact(np.outer(self.linear.centre.factors, k), shape)

    def _points(self, window: CellTimes, tube: Tube | None) -> Iterator[dict[str, Array]]:
        """Yield arguments at three instants of windows: the middles and random corners of tube and factors."""
        along = self._along(window)
        if tube is None:
            yield along
            return
        size, k = tube.symbols, len(along["c"].T)
        corners = np.random.default_rng(SEED).integers(0, 2, (POINTS - 1, size + len(FACTORS), k)).astype(float)
        for share in (np.full((size + len(FACTORS), k), 0.5), *corners):
            f = self.low[:, None] + share[size:] * 2 * self._half[:, None]
            yield along | {"z": tube.corners(share[:size]), "f": f}

    def _along(self, window: CellTimes) -> dict[str, Array]:
        """Return the arguments along the centre motion at three instants of the sampled windows."""
        t = (window.middle[self._at] + window.radius * np.array(INSTANTS)[:, None]).ravel()
        c = np.repeat(self.linear.centre.factors[:, None], len(t), axis=1)
        return {"path": self._path.columns(t), "jets": self._cells.columns(t), "c": c}

    def _apart(self, enclosure: Enclosure, known: Array) -> Array:
        """Return the largest distances (size,) of an output from known values (c, size) of the cells."""
        at_points = self._at_points(known).T
        return np.asarray(np.max([models.minus(at_points).magnitude for models in enclosure], axis=(0, 2)))

    def _matrices_apart(self, enclosure: Enclosure, middle: Array, left: Array, right: Array) -> MatrixModels:
        """Return left (X - middle) right for matrices X; left, middle: of the cells (c, ..), or left of all.

        The signs of a model's coefficients are kept, so that X acts on the coordinates, not on the joints.
        """
        rows, columns = middle.shape[1:]
        known = self._at_points(middle.transpose(0, 2, 1).reshape(len(middle), -1)).T
        left = self._at_points(left)[:, None] if left.ndim == 3 else left
        values = []
        for models in enclosure:
            apart = models.minus(known).values
            matrices = apart.reshape(len(apart), columns, rows, -1).transpose(0, 3, 2, 1)
            values.append(MatrixModels(matrices, models.shape).between(left, right).values)
        return MatrixModels(np.concatenate(values), enclosure[0].shape)

    def _at_points(self, of_cells: Array) -> Array:
        """Return values (c, ..) of the cells at the instants of the ranges."""
        return of_cells if self._cells.verified else np.concatenate([of_cells[self._at]] * len(INSTANTS))


def _after_zeros(columns: Array) -> Array:
    """Return columns (c, rows, k) after a first one of zeros."""
    return np.concatenate([np.zeros((*columns.shape[:2], 1)), columns], axis=2)


def _called(function: ca.Function, arguments: dict[str, Array]) -> list[Array]:
    return columnwise(function, *(arguments[name] for name in function.name_in()))
