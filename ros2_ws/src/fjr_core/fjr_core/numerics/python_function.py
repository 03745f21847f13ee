# SPDX-License-Identifier: Apache-2.0
"""Wrap Python code of the user as a CasADi function: it may be part of other functions, but is never compiled."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ..errors import FjrError, UserCodeError
from ..files.python_class import described
from .checks import Array

Shapes = Mapping[str, tuple[int, ...]]
"""Names of arguments or results with the shapes of their arrays."""


class PythonFunction(ca.Callback):
    """A CasADi function that calls `evaluate` with copies of its arguments, which are read-only.

    evaluate: arrays of the shapes `inputs` -> one result for each of `outputs`. CasADi stores a symbol (n, 5) by
    columns, as an array (5, n). Derivatives are central differences.
    If `evaluate` raises an exception, or a result has another shape, all results are nan and `raise_failure` raises
    UserCodeError. The object must live as long as the functions that contain it.
    """

    def __init__(self, name: str, evaluate: Callable[..., Sequence[Any]], inputs: Shapes, outputs: Shapes) -> None:
        ca.Callback.__init__(self)
        self._evaluate, self._inputs, self._outputs = evaluate, dict(inputs), dict(outputs)
        self._failure: FjrError | None = None
        self.construct(name, {"enable_fd": True, "fd_method": "central"})

    def raise_failure(self) -> None:
        """Raise the first error since the last call, if there is one."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def get_n_in(self) -> int:
        """Return the number of arguments."""
        return len(self._inputs)

    def get_n_out(self) -> int:
        """Return the number of results."""
        return len(self._outputs)

    def get_name_in(self, i: int) -> str:
        """Return the name of an argument."""
        return list(self._inputs)[i]

    def get_name_out(self, i: int) -> str:
        """Return the name of a result."""
        return list(self._outputs)[i]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the shape of an argument, dense."""
        return _dense(list(self._inputs.values())[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        """Return the shape of a result, dense."""
        return _dense(list(self._outputs.values())[i])

    def has_eval_buffer(self) -> bool:
        """Return True: `eval_buffer` is called, which copies less than `eval`."""
        return True

    def eval_buffer(self, arguments: Sequence[Any], results: Sequence[Any]) -> int:
        """Evaluate with memory of CasADi; return 0 for success, also after a failure."""
        shapes = self._inputs.values()
        given = [_array(memory, shape) for memory, shape in zip(arguments, shapes, strict=True)]
        for memory, value in zip(results, self._values(given), strict=True):
            if memory is not None:
                np.frombuffer(memory)[:] = value
        return 0

    def _values(self, given: list[Array]) -> list[Array | float]:
        try:
            found = self._evaluate(*given)
            pairs = zip(self._outputs.items(), found, strict=True)
            return [checked(f"{name} of {self.name()}", value, shape) for (name, shape), value in pairs]
        except FjrError as error:
            self._failure = self._failure or error
        except Exception as error:
            self._failure = self._failure or UserCodeError(f"{self.name()} raises {described(error)}; expected a value")
        return [np.nan] * len(self._outputs)


def checked(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return a result as an array of the expected shape; raises UserCodeError for another one. It may be nan."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise UserCodeError(f"{name} is {value!r}; expected numbers of shape {shape}") from None
    if array.shape != shape:
        raise UserCodeError(f"{name} has shape {array.shape}; expected {shape}")
    return array


def _array(memory: Any, shape: tuple[int, ...]) -> Array:
    array = np.zeros(shape) if memory is None or 0 in shape else np.frombuffer(memory).reshape(shape).copy()
    array.setflags(write=False)
    return array


def _dense(shape: tuple[int, ...]) -> ca.Sparsity:
    """Return the CasADi shape of an array: its transpose, since CasADi stores by columns."""
    rows, columns = (*reversed(shape), 1, 1)[:2]
    return ca.Sparsity.dense(rows, columns)
