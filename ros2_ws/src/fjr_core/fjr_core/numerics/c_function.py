# SPDX-License-Identifier: Apache-2.0
"""Lend CasADi functions, and memory for their temporary values, to C code that calls them by type fjr_function."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from .jit import machine_code
from .symbolic import bind

MOST = 8  # arguments, and results, of a function that the C files call


class CFunction:
    """A CasADi function as a pointer of type fjr_function; it must outlive the C code that calls it.

    failed: called after each evaluation in Python; True if it failed. The pointer then returns 1.
    """

    def __init__(self, ffi: Any, function: ca.Function, failed: Any = None) -> None:
        self._ffi, self.function, self._failed = ffi, function, failed
        address = machine_code(function)
        if address is None:
            self._arguments = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
            self._results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
            self._trigger = bind(function, self._arguments, self._results)
            self.pointer = ffi.callback("fjr_function", self._evaluate, error=1)
        else:
            self.pointer = ffi.cast("fjr_function", address)

    def _evaluate(self, arg: Any, res: Any, _iw: Any, _w: Any, _mem: int) -> int:
        for i, argument in enumerate(self._arguments):
            if argument.size and arg[i] != self._ffi.NULL:
                argument[:] = np.frombuffer(self._ffi.buffer(arg[i], argument.nbytes))
        try:
            self._trigger()
        except RuntimeError:  # a root finder did not converge
            return 1
        for i, result in enumerate(self._results):
            if result.size and res[i] != self._ffi.NULL:
                np.frombuffer(self._ffi.buffer(res[i], result.nbytes))[:] = result
        return 1 if self._failed is not None and self._failed() else 0


class WorkSpace:
    """Memory for the temporary values of some functions in C."""

    def __init__(self, ffi: Any, functions: Sequence[ca.Function]) -> None:
        most = {size: max(1, *(getattr(f, f"sz_{size}")() for f in functions)) for size in ("arg", "res", "iw", "w")}
        self.arg = ffi.new("const double*[]", max(MOST, most["arg"]))
        self.res = ffi.new("double*[]", max(MOST, most["res"]))
        self.iw, self.w = ffi.new("long long[]", most["iw"]), ffi.new("double[]", most["w"])

    def lend(self, struct: Any) -> None:
        """Let a structure point to the memory."""
        for name in ("arg", "res", "iw", "w"):
            setattr(struct, name, getattr(self, name))
