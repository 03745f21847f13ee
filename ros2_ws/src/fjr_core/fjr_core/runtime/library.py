# SPDX-License-Identifier: Apache-2.0
"""Build the control step (step.h and the C files beside it), open it by cffi, and give it CasADi functions.

cffi reads the declarations from step.h itself, so that each structure stands once.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..numerics import jit
from ..numerics.c_library import ffi_of
from ..numerics.symbolic import bind

HEADER = "step.h"
SOURCES = (
    "journal.c",
    "stamps.c",
    "measurement.c",
    "reference.c",
    "state_limits.c",
    "effort_limits.c",
    "stop_policy.c",
    "transfer.c",
    "law.c",
    "active_reference.c",
    "supervisor.c",
    "wiring_rows.c",
    "wiring.c",
    "step.c",
    "certificate.c",
    "auxiliary_rate.c",
)
"""The C files in the order of their translation unit."""
_DEFINED = re.compile(r"^#define (\w+) (\d+)\b.*$", re.MULTILINE)
_NUMBER = re.compile(r"^#define (\w+) ([\d.e+-]+)", re.MULTILINE)
_DIRECTIVE = re.compile(r"^#.*$", re.MULTILINE)


class StepLibrary(NamedTuple):
    """The compiled step with cffi's types: `new` makes structures, `lib` holds the functions of step.h."""

    ffi: Any
    lib: Any
    path: str


@cache
def step_library(n: int, memory: int = 1) -> StepLibrary:
    """Return the step for n joints and a law with `memory` numbers as its controller state, compiled and cached.

    Raises CompilerError without a C compiler.
    """
    path = jit.shared_object("control_step", c_text(n, memory))
    ffi = ffi_of(declarations(text(HEADER), {"FJR_N": n, "FJR_MEMORY": max(1, memory)}))
    return StepLibrary(ffi, ffi.dlopen(path), path)


def c_text(n: int, memory: int) -> str:
    """Return the translation unit of the step for n joints and a controller state of `memory` numbers."""
    defined = f"#define FJR_N {n}\n#define FJR_MEMORY {max(1, memory)}\n"
    return "\n".join([defined, text(HEADER), *included(SOURCES)])


def included(names: Iterable[str]) -> list[str]:
    """Return the texts of C files without their own includes of step.h."""
    return [text(name).replace(f'#include "{HEADER}"\n', "") for name in names]


def text(name: str) -> str:
    """Return the text of a file of this folder."""
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def constant(name: str) -> float:
    """Return the number of a macro of step.h or of the C files. Raises KeyError."""
    return {found: float(number) for found, number in _NUMBER.findall(c_text(1, 1))}[name]


def declarations(header: str, values: dict[str, int]) -> str:
    """Return a header as cffi reads it: without directives, and with the macros that are numbers replaced."""
    values = values | {name: int(value) for name, value in _DEFINED.findall(header)}
    for name, value in values.items():
        header = re.sub(rf"\b{name}\b", str(value), header)
    return _DIRECTIVE.sub("", header)


class CFunction:
    """A CasADi function as a pointer of type fjr_function; it must outlive the C code that calls it.

    failed: called after each evaluation in Python; True if it failed. The pointer then returns 1.
    """

    def __init__(self, ffi: Any, function: ca.Function, failed: Any = None) -> None:
        self._ffi, self.function, self._failed = ffi, function, failed
        address = jit.machine_code(function)
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

    def __init__(self, ffi: Any, functions: Sequence[ca.Function], arguments: int = 8) -> None:
        most = {size: max(1, *(getattr(f, f"sz_{size}")() for f in functions)) for size in ("arg", "res", "iw", "w")}
        self.arg = ffi.new("const double*[]", max(arguments, most["arg"]))
        self.res = ffi.new("double*[]", max(arguments, most["res"]))
        self.iw, self.w = ffi.new("long long[]", most["iw"]), ffi.new("double[]", most["w"])

    def lend(self, struct: Any) -> None:
        """Let a structure point to the memory."""
        for name in ("arg", "res", "iw", "w"):
            setattr(struct, name, getattr(self, name))
