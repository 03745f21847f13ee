# SPDX-License-Identifier: Apache-2.0
"""Build the control step (step.h and the C files beside it) for n joints and open it by cffi.

cffi reads the declarations from step.h itself, so that each structure stands once.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from ..numerics import jit
from ..numerics.c_library import ffi_of

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
