# SPDX-License-Identifier: Apache-2.0
"""Build CasADi expressions and functions, and call the functions with NumPy arrays."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import StateError
from .checks import Array, floats

BROADCAST = ("u", "delta_u", "omega")  # efforts: a scalar stands for n equal entries
TIMES = ("t", "dt")  # numbers


def symbols(kind: type = ca.SX, **rows: int) -> dict[str, ca.SX]:
    """Return column symbols of the given numbers of rows by name."""
    return {name: kind.sym(name, size) for name, size in rows.items()}  # type: ignore[attr-defined]


def solve(A: ca.SX | ca.DM, b: ca.SX) -> ca.SX:
    """Return A^-1 b for a symmetric positive definite A (n, n), by its LDL' factors."""
    if A.shape == (1, 1):
        return b / A
    return ca.ldl_solve(b, *ca.ldl(ca.SX(A)))


def sparse(matrix: ca.SX | ArrayLike) -> ca.SX:
    """Return a numeric or symbolic matrix with structural zeros removed."""
    return ca.sparsify(matrix if isinstance(matrix, ca.SX) else ca.SX(ca.DM(matrix)))


class NumericFunction(threading.local):
    """A CasADi function of float arrays; buffers are bound once per thread, results are copies.

    CasADi is column-major: a symbol of shape (n, 5) is an array of shape (5, n), and a column is an array (n,).
    """

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self._names = function.name_in()
        shapes = [() if name in TIMES else _numpy_shape(*function.size_in(name)) for name in self._names]
        self._arguments = [np.zeros(shape) for shape in shapes]
        self._results = [np.zeros(_numpy_shape(*function.size_out(i))) for i in range(function.n_out())]
        self._trigger = bind(function, self._arguments, self._results)

    def __call__(self, *arguments: ArrayLike) -> tuple[Array, ...]:
        """Evaluate the function; arguments in BROADCAST may be scalars. Raises StateError for a wrong shape."""
        for name, own, given in zip(self._names, self._arguments, arguments, strict=True):
            if type(given) is np.ndarray and given.shape == own.shape and given.dtype == own.dtype:
                own[...] = given
            else:
                _assign(name, own, given)
        try:
            self._trigger()
        except RuntimeError:
            raise not_converged(self.function) from None
        return tuple([result.copy() for result in self._results])


def evaluate(function: ca.Function, *arguments: ArrayLike) -> tuple[Array, ...]:
    """Evaluate a function as its NumericFunction, which is made at the first call; a function has one."""
    if not hasattr(function, "numeric"):
        function.numeric = NumericFunction(function)
    found: tuple[Array, ...] = function.numeric(*arguments)
    return found


def _assign(name: str, own: Array, given: ArrayLike) -> None:
    array = floats(name, given, StateError, f" of shape {own.shape}")
    if array.shape != own.shape and not (array.shape == () and name in BROADCAST):
        raise StateError(f"{name} has shape {array.shape}; expected {own.shape}")
    own[...] = array


def not_converged(function: ca.Function) -> StateError:
    """Return the error of a function whose root finder failed."""
    return StateError(f"{function.name()} did not converge; expected a shorter step")


def bind(function: ca.Function, arguments: Sequence[Array], results: Sequence[Array]) -> Callable[[], None]:
    """Return a callable that evaluates the function on these argument and result arrays.

    All are distinct contiguous float arrays of the sizes of the function; the callable holds references. Not
    thread-safe.
    """
    buffer, trigger = function.buffer()
    for i, array in enumerate(arguments):
        buffer.set_arg(i, array.data)
    for i, array in enumerate(results):
        buffer.set_res(i, array.data)
    trigger.held = (buffer, *arguments, *results)  # keep the buffers alive as long as the callable
    return trigger


def evaluate_rows(function: ca.Function, *arguments: ArrayLike) -> list[Array]:
    """Return the dense outputs (k, size) of a function at k rows of its arguments (k, size), all column-major."""
    given = [np.ascontiguousarray(rows, dtype=float) for rows in arguments]  # a call would convert them one by one
    found = [np.empty((len(given[0]), function.numel_out(i))) for i in range(function.n_out())]
    if len(given[0]):
        bind(function.map(len(given[0])), given, found)()
    return found


def _numpy_shape(rows: int, columns: int) -> tuple[int, ...]:
    return (columns, rows) if columns > 1 else (rows,)


def dense_function(
    name: str, inputs: dict[str, ca.SX | ca.MX], outputs: dict[str, ca.SX | ca.MX], cse: bool = False
) -> ca.Function:
    """Return a CasADi function of named symbols with dense outputs; cse: eliminate common subexpressions."""
    dense = [ca.densify(e) for e in outputs.values()]
    return ca.Function(name, list(inputs.values()), dense, list(inputs), list(outputs), {"cse": cse})


class PackedVector:
    """Names and sizes of the consecutive parts of a vector."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        self.sizes = dict(sizes)
        self.size = sum(self.sizes.values())

    def unpack(self, vector: ca.MX) -> dict[str, ca.MX]:
        """Return the parts of the vector (size,) by name."""
        if not self.sizes:
            return {}
        ends = np.cumsum([0, *self.sizes.values()]).tolist()
        return dict(zip(self.sizes, ca.vertsplit(vector, ends), strict=True))

    def named(self, vector: ca.SX) -> SimpleNamespace:
        """Return the parts of the vector (size,) as attributes."""
        return SimpleNamespace(**self.unpack(vector))

    def pack(self, parts: Mapping[str, ca.MX]) -> ca.MX:
        """Return the vector (size,) of the parts."""
        return ca.vertcat(*(parts[name] for name in self.sizes))
