# SPDX-License-Identifier: Apache-2.0
"""Enclose CasADi functions by Taylor models: polynomials in time, linear in deviations, with a bound of the rest.

    a(t, y) = a_0 + a_1 t + .. + a_(K-1) t^(K-1) + sum of t^l y_j b_lj for l < L +- r,   |t| <= 1, |y_j| <= 1

Interval arithmetic forgets that the values of an expression depend on each other: on a seven-joint law its ranges are
thousands of times too wide. A Taylor model keeps this dependence to the order of its polynomial; products of higher
order and all roundings are bounded by r. taylor_models.c computes.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from os import cpu_count
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import ParameterError, StateError
from fjr_core.numerics.c_library import c_library
from fjr_core.numerics.checks import Array

UP = 1 + 2.0**-43
"""Factor that covers the rounding of a sum of up to 500 terms."""
ROUNDED = 2.0**-52
"""Relative error of a number that is rounded twice."""
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


NUMBER = Shape(0, order=1)
"""Shape of numbers with a bound of their error."""


@dataclass(frozen=True, eq=False)
class TaylorModels:
    """Models of size x k numbers: values (k, size, shape.width), coefficients of t, then of t^l y_j, then r."""

    values: Array
    shape: Shape

    @classmethod
    def exact(cls, numbers: ArrayLike, shape: Shape = NUMBER) -> TaylorModels:
        """Return the numbers (size, k) themselves."""
        given = np.asarray(numbers, dtype=float).T
        values = np.zeros((*given.shape, shape.width))
        values[..., 0] = given
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
    def boxes(cls, middle: ArrayLike, radius: ArrayLike, first: int, shape: Shape) -> TaylorModels:
        """Return numbers within radii of middles (size, k); each wide one is a symbol, the first `first`."""
        models, half = cls.exact(middle, shape), np.asarray(radius, dtype=float)
        for j, i in enumerate(np.flatnonzero(np.any(half > 0, axis=1))):
            models.values[:, i, shape.order + first + j] = half[i]
            models.values[:, i, -1] = ROUNDED * (np.abs(models.values[:, i, 0]) + half[i])
        return models

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
        inputs = np.ascontiguousarray(np.concatenate([each.values for each in arguments], axis=1))
        boxes, shape = len(inputs), arguments[0].shape
        results = np.empty((boxes, self.outputs, shape.width))
        parts = np.array_split(np.arange(boxes), cpu_count() or 1)
        with ThreadPoolExecutor() as pool:
            failed = list(pool.map(lambda part: self._evaluate(inputs[part], results, part, shape), parts))
        if any(failed) or not np.all(np.isfinite(results)):
            raise ZeroDivisionError("a Taylor model that may be zero")
        return [TaylorModels(each, shape) for each in np.split(results, self.ends, axis=1)]

    def _evaluate(self, inputs: Array, results: Array, part: Any, shape: Shape) -> int:
        if not len(part):
            return 0
        ffi, library = _library(shape)
        memory = np.empty((self.function.sz_w() + 1, inputs.shape[2]))
        found = results[part[0] : part[-1] + 1]
        buffers = [ffi.from_buffer("double[]", each) for each in (np.ascontiguousarray(inputs), found, memory)]
        return library.fjr_taylor_evaluate(self._tape(ffi)[0], buffers[0], len(part), *buffers[1:])

    def _tape(self, ffi: Any) -> tuple[Any, Any]:
        """Return the structure of C, and what it refers to."""
        lists = {"op": self._op, "out": self._out, "left": self._left, "right": self._right}
        fields = {name: ffi.from_buffer("int32_t[]", array) for name, array in lists.items()}
        fields["number"] = ffi.from_buffer("double[]", self._number)
        values = {**fields, "count": len(self._op), "inputs": self.inputs, "outputs": self.outputs}
        return ffi.new("struct fjr_tape *", values), values


taylor_function = lru_cache(maxsize=16)(TaylorFunction)
"""The TaylorFunction of an SX function, kept."""


@lru_cache
def _library(shape: Shape) -> tuple[Any, Any]:
    """Return cffi's types and the compiled arithmetic; raises CompilerError.

    The bounds of its rounding hold for up to 500 coefficients.
    """
    if shape.symbols and shape.mixed > shape.order or shape.width > 500:
        raise ParameterError(f"{shape}: expected at most 500 values, and mixed at most order")
    return c_library(__file__, dict(zip("MKL", shape, strict=True)), ["-fopenmp-simd"])
