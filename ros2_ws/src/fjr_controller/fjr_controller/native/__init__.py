# SPDX-License-Identifier: Apache-2.0
"""The command loop in C, and the functions of the control step that it calls."""

from __future__ import annotations

from functools import cache
from typing import Any

from fjr_core.numerics.jit import CLibrary
from fjr_core.runtime import library
from fjr_msgs_py.native.program import Program


@cache
def controller_program(n: int, memory: int) -> Program:
    """Return the command loop for a step of n joints and a law with `memory` numbers as its controller state."""
    values, header = library.sizes(n, memory), library.text(library.HEADER)
    return Program.of("fjr_controller", ["controller_loop.h", "controller_loop.c"], values, header)


def step_functions(program: Program, step: CLibrary) -> dict[str, Any]:
    """Return the fields of struct fjr_step_functions: functions of step.h without the prefix fjr_."""
    names = dict(program.ffi.typeof("struct fjr_step_functions").fields)
    return program.cast(
        "struct fjr_step_functions", {name: step.ffi.addressof(step.lib, f"fjr_{name}") for name in names}
    )
