# SPDX-License-Identifier: Apache-2.0
"""Enclose CasADi functions by Taylor models: polynomials in time, linear in deviations, with a bound of the rest.

    a(t, y) = a_0 + a_1 t + .. + a_(K-1) t^(K-1) + sum of t^l y_j b_lj for l < L +- r,   |t| <= 1, |y_j| <= 1

Interval arithmetic forgets that the values of an expression depend on each other: on a seven-joint law its ranges are
thousands of times too wide. A Taylor model keeps this dependence to the order of its polynomial; products of higher
order and all roundings are bounded by r. taylor_models.c computes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import ParameterError, StateError
from fjr_core.motions.sine import Sines
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import c_library_of

UP = 1 + 2.0**-43
"""Factor that covers the rounding of a sum of up to 500 terms."""
ROUNDED = 2.0**-52
"""Relative error of a number that is rounded twice."""
ROUNDING = 1 + 1e-9
"""Factor that covers the rounding of products and sums: less than 1e5 operations of relative error 2^-53 each."""
PRODUCTS = 1e-13
"""Relative error of two products of matrices of up to 100 rows."""
SINES = 1e-11
"""Relative error of a sum of sines, beside that by the rounding of their angles."""
LANES = 8
"""Boxes that are computed together."""
OPERATIONS = (
    *(ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV),
    *(ca.OP_SIN, ca.OP_COS, ca.OP_ASSIGN, ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT),
)
"""Operations of CasADi, in the order of those of taylor_models.c."""


class Shape(NamedTuple):
    """Number M of deviations y, and numbers K and L of powers of t: of those alone, and of those beside deviations."""

    symbols: int
    order: int = 5
    mixed: int = 2

    @property
    def width(self) -> int:
        """Number of values of a model."""
        return self.order + self.mixed * self.symbols + 1


NUMBER = Shape(0, order=1, mixed=1)
"""Shape of numbers with a bound of their error: intervals."""


@dataclass(frozen=True, eq=False)
class TaylorModels:
    """Models of size x k numbers: values (k, size, shape.width), coefficients of t, then of t^l y_j, then r."""

    values: Array
    shape: Shape

    @classmethod
    def exact(cls, numbers: ArrayLike, shape: Shape = NUMBER) -> TaylorModels:
        """Return the numbers (size, k) themselves."""
        middle = np.asarray(numbers, dtype=float).T
        values = np.zeros((*middle.shape, shape.width))
        values[..., 0] = middle
        return cls(values, shape)

    @classmethod
    def linear(cls, slopes: ArrayLike, shape: Shape) -> TaylorModels:
        """Return sums of deviations, y_1 first, with slopes (size, M', k)."""
        given = np.asarray(slopes, dtype=float).transpose(2, 0, 1)
        values = np.zeros((*given.shape[:2], shape.width))
        values[..., shape.order : shape.order + given.shape[2]] = given
        values[..., -1] = ROUNDED * np.abs(given).sum(axis=2)
        return cls(values, shape)

    @classmethod
    def sines(cls, reference: Sines, middle: Array, radius: float, derivatives: int, shape: Shape) -> TaylorModels:
        """Return q, dq, .. (derivatives n, k) of a reference in the time of windows, from -1 at their start to 1.

        middle (k,), radius [s]: of the windows. The rounding of a sum of sines is bounded by SINES and four roundings
        of their largest angle, times the sum of their amplitudes.
        """
        order = shape.order
        amplitude, frequency, phase = reference.rows
        inexact = SINES + 4 * ROUNDED * float(np.max(np.abs(frequency) * np.abs(middle).max() + np.abs(phase)))
        largest = [np.abs(amplitude * frequency**i).sum(axis=0) for i in range(derivatives + order)]
        largest[0] = largest[0] + np.abs(np.asarray(reference.offset))
        scale = [radius**k / factorial(k) for k in range(order + 1)]
        jets = [sine_derivative(reference, middle, i) for i in range(derivatives + order - 1)]
        values = np.zeros((len(middle), derivatives, reference.n, shape.width))
        for i in range(derivatives):
            for k in range(order):
                values[:, i, :, k] = scale[k] * jets[i + k]
                values[:, i, :, -1] += inexact * scale[k] * largest[i + k]
            values[:, i, :, -1] += (1 + inexact) * scale[order] * largest[i + order]
        return cls(values.reshape(len(middle), -1, shape.width), shape)

    def among(self, shape: Shape) -> TaylorModels:
        """Return the models, which contain no deviations, in a shape of the same order with deviations."""
        values = np.zeros((*self.values.shape[:2], shape.width))
        values[..., : shape.order], values[..., -1] = self.values[..., : shape.order], self.values[..., -1]
        return TaylorModels(values, shape)

    def minus(self, numbers: Array) -> TaylorModels:
        """Return the models less numbers (size, k)."""
        values = self.values.copy()
        values[..., 0] -= numbers.T
        values[..., -1] = UP * (values[..., -1] + ROUNDED * np.abs(values[..., 0]))
        return TaylorModels(values, self.shape)

    def mean_within(self, share: float) -> TaylorModels:
        """Return models of the means over times, each of which is on average within a share of 1 from the middle."""
        values = self.values.copy()
        if self.shape.order > 1:
            values[..., 1] *= share
        return TaylorModels(values, self.shape)

    @property
    def magnitude(self) -> Array:
        """Bounds (size, k) of the absolute values."""
        return np.asarray(UP * np.abs(self.values).sum(axis=-1).T)


@dataclass(frozen=True, eq=False)
class MatrixModels:
    """Models of matrices X in k boxes: values (k, columns, rows, shape.width); the last are bounds of the rest."""

    values: Array
    shape: Shape

    def between(self, left: Array, right: Array) -> MatrixModels:
        """Return left X right; left: of all boxes, or of each (k, .., rows). The signs of all coefficients are kept."""
        k, columns, rows, width = self.values.shape
        rest = self.values[..., -1] + PRODUCTS * np.abs(self.values[..., :-1]).sum(axis=-1)
        by_right = (right.T @ self.values.reshape(k, columns, rows * width)).reshape(k, -1, rows, width)
        values = left[..., None, :, :] @ by_right
        values[..., -1] = np.abs(right.T) @ rest @ np.abs(left).swapaxes(-1, -2)
        return MatrixModels(values, self.shape)

    def mean_from_zero(self) -> MatrixModels:
        """Return models of the mean of X on the way from the middle of the tube, where its terms grow in proportion."""
        values = self.values.copy()
        values[..., self.shape.order : -1] /= 2
        return MatrixModels(values, self.shape)

    def beside(self, M: MatrixModels) -> MatrixModels:
        """Return models of torques with further columns, those of minus the inertia for the first rows."""
        k, columns, rows, width = M.values.shape
        more = np.zeros((k, columns, self.values.shape[2], width))
        more[:, :, :rows] = -M.values
        more[..., -1] = np.abs(more[..., -1])
        return MatrixModels(np.concatenate([self.values, more], axis=1), self.shape)

    @property
    def largest(self) -> Array:
        """Largest elements (rows, columns) of |X|."""
        return np.asarray(ROUNDING * np.abs(self.values).sum(axis=-1).max(axis=0).T)

    def along(self, lines: Array, known: slice = slice(0)) -> Array:
        """Return the largest elements (rows,) of X times a sum of lines (k, columns, u), each times -1 to 1.

        known: symbols whose products with the lines are left out, as `products` returns them.
        """
        if not lines.shape[2]:
            return np.zeros(self.values.shape[2])
        unknown = np.delete(self.values[..., :-1], self._places(known), axis=3)
        signed = np.abs(_applied(unknown, lines)).sum(axis=(1, 3))
        rest = (np.abs(lines).sum(axis=2)[:, None] @ self.values[..., -1])[:, 0]
        return np.asarray(ROUNDING * (signed + rest).max(axis=0))

    def products(self, lines: Array) -> Array:
        """Return the products (k, rows, u, u) of the slopes of X in its symbols, those of the lines, and the lines."""
        return _applied(self.values[..., self._places(slice(None))], lines).transpose(0, 2, 3, 1)

    def of(self, symbol: int) -> MatrixModels:
        """Return models of what a symbol contributes, to first order."""
        place = self.shape.order + symbol
        values = np.zeros_like(self.values)
        values[..., place] = self.values[..., place]
        return MatrixModels(values, self.shape)

    def _places(self, symbols: slice) -> slice:
        """Return the places of the slopes in these symbols."""
        first, last, _ = symbols.indices(self.shape.symbols)
        return slice(self.shape.order + first, self.shape.order + last)


def _applied(coefficients: Array, lines: Array) -> Array:
    """Return the products (k, u, rows, l) of coefficients (k, columns, rows, l) and lines (k, columns, u)."""
    k, columns, rows, count = coefficients.shape
    products = lines.swapaxes(1, 2) @ coefficients.reshape(k, columns, rows * count)
    return np.asarray(products.reshape(k, -1, rows, count))


class TaylorFunction:
    """An SX function that is evaluated on Taylor models of many boxes at once.

    Raises StateError for an operation that is not in OPERATIONS.
    """

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        names = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}
        first_in = np.cumsum([0, *(function.nnz_in(i) for i in range(function.n_in()))])
        first_out = np.cumsum([0, *(function.nnz_out(i) for i in range(function.n_out()))])
        self.inputs, self.outputs, self.ends = int(first_in[-1]), int(first_out[-1]), first_out[1:-1]
        count, number = function.n_instructions(), {operation: i for i, operation in enumerate(OPERATIONS)}
        self._op, self._out, self._left, self._right = (np.zeros(count, dtype=np.int32) for _ in range(4))
        self._number = np.zeros(count)
        for k in range(count):
            operation, results = function.instruction_id(k), function.instruction_output(k)
            operands = function.instruction_input(k)
            if operation not in number:
                raise StateError(f"{function.name()} contains {names[operation]}, which has no Taylor model")
            self._op[k], self._out[k] = number[operation], results[0]
            if operation == ca.OP_INPUT:
                self._left[k] = first_in[operands[0]] + operands[1]
            elif operation == ca.OP_OUTPUT:
                self._out[k], self._left[k] = first_out[results[0]] + results[1], operands[0]
            elif operation == ca.OP_CONST:
                self._number[k] = function.instruction_constant(k)
            else:
                self._left[k], self._right[k] = operands[0], operands[-1]

    def __call__(self, *arguments: TaylorModels) -> list[TaylorModels]:
        """Return models of the results, column-major. Raises ZeroDivisionError if a divisor may be 0."""
        inputs = np.ascontiguousarray(np.concatenate([models.values for models in arguments], axis=1))
        boxes, shape = len(inputs), arguments[0].shape
        results = np.empty((boxes, self.outputs, shape.width))
        memory = np.empty((self.function.sz_w() + 1, shape.width, LANES))
        ffi, library = _library(shape)
        lists = {"op": self._op, "out": self._out, "left": self._left, "right": self._right}
        fields = {name: ffi.from_buffer("int32_t[]", array) for name, array in lists.items()}
        fields["number"] = ffi.from_buffer("double[]", self._number)
        sizes = {"count": len(self._op), "inputs": self.inputs, "outputs": self.outputs}
        tape = ffi.new("struct fjr_tape *", {**fields, **sizes})
        given, enclosed, work = (ffi.from_buffer("double[]", array) for array in (inputs, results, memory))
        if library.fjr_taylor_evaluate(tape, given, boxes, enclosed, work) or not np.all(np.isfinite(results)):
            raise ZeroDivisionError("a Taylor model that may be zero")
        return [TaylorModels(values, shape) for values in np.split(results, self.ends, axis=1)]


taylor_function = lru_cache(maxsize=16)(TaylorFunction)
"""The TaylorFunction of an SX function, kept."""


def sine_derivative(reference: Sines, t: Array, order: int) -> Array:
    """Return a derivative (k, n) of a sum of sines at times t (k,) [s]."""
    amplitude, frequency, phase = reference.rows
    angle = np.multiply.outer(t, frequency) + phase + order * np.pi / 2
    derivative = (amplitude * frequency**order * np.sin(angle)).sum(axis=-2)
    return np.asarray(derivative + np.asarray(reference.offset) if order == 0 else derivative)


@lru_cache
def _library(shape: Shape) -> tuple[Any, Any]:
    """Return cffi's types and the compiled arithmetic; raises CompilerError.

    The bounds of its rounding hold for up to 500 coefficients.
    """
    if shape.symbols and shape.mixed > shape.order or shape.width > 500:
        raise ParameterError(f"{shape}: expected at most 500 values, and mixed at most order")
    return c_library_of(__file__, {**dict(zip("MKL", shape, strict=True)), "LANES": LANES}, ["-Wno-psabi"])[:2]
