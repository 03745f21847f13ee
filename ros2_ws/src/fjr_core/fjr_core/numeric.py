# SPDX-License-Identifier: Apache-2.0
"""CasADi functions called with NumPy arrays at the cost of the arithmetic, not of the conversion."""

from __future__ import annotations

import threading

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .checks import Array
from .errors import StateError

SPREAD = ("u", "delta_u", "omega")  # efforts: a scalar stands for n equal entries


class NumericFunction(threading.local):
    """A CasADi function on float arrays; buffers are bound once per thread, results are fresh copies.

    `shapes` gives the NumPy shape of every argument. CasADi stores columns first, so an argument of
    shape (5, n) here is the symbol of shape (n, 5) there.
    """

    def __init__(self, function: ca.Function, shapes: tuple[tuple[int, ...], ...]) -> None:
        self._function = function
        self._arguments = [np.zeros(shape) for shape in shapes]
        self._results = [np.zeros(_numpy_shape(function, i)) for i in range(function.n_out())]
        buffer, self._trigger = function.buffer()
        for i, argument in enumerate(self._arguments):
            buffer.set_arg(i, argument.data)
        for i, result in enumerate(self._results):
            buffer.set_res(i, result.data)
        self._buffer = buffer

    def __call__(self, *arguments: ArrayLike) -> tuple[Array, ...]:
        """Evaluate; raises StateError when an argument does not fit (a scalar may stand for those in SPREAD)."""
        for name, own, given in zip(self._function.name_in(), self._arguments, arguments, strict=True):
            try:
                shape = np.shape(given)
                if shape == own.shape or (shape == () and name in SPREAD):
                    own[...] = given
                    continue
            except (TypeError, ValueError):
                raise StateError(f"{name} is {given!r}; expected numbers of shape {own.shape}") from None
            raise StateError(f"{name} has shape {shape}; expected {own.shape}")
        try:
            self._trigger()
        except RuntimeError:
            raise StateError(f"{self._function.name()} did not converge; expected a shorter step") from None
        return tuple(result.copy() for result in self._results)


def _numpy_shape(function: ca.Function, i: int) -> tuple[int, ...]:
    rows, columns = function.size_out(i)
    return (columns, rows) if columns > 1 else (rows,)


def numeric(
    name: str, inputs: dict[str, ca.SX | ca.MX], outputs: dict[str, ca.SX | ca.MX], **shapes: tuple[int, ...]
) -> NumericFunction:
    """Bind named symbols and expressions to a callable; `shapes` overrides an argument's (rows,) shape."""
    dense = [ca.densify(e) for e in outputs.values()]
    function = ca.Function(name, list(inputs.values()), dense, list(inputs), list(outputs))
    return NumericFunction(function, tuple(shapes.get(key, (s.numel(),)) for key, s in inputs.items()))
