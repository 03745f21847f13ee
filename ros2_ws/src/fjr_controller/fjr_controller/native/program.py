# SPDX-License-Identifier: Apache-2.0
"""Build the native command loop for a control step, and the functions of the step that are called by it."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from fjr_core.runtime import library
from fjr_core.runtime.library import StepLibrary
from fjr_msgs_py.native.program import Program, common_headers, common_sources

PART = "controller_loop"
FUNCTIONS = (
    *("step", "check_wiring", "silence", "stop_effort", "start", "apply", "use_gains", "follow", "hold", "resume"),
    *("certify", "certificate_restart", "is_due", "waits_until"),
)
"""Fields of struct fjr_step_functions: functions of step.h without the prefix fjr_."""


@cache
def controller_program(n: int, memory: int) -> Program:
    """Return the native command loop for a step of n joints and a law with `memory` numbers as its controller state.

    Raises NativeError if it cannot be built.
    """
    values = {"FJR_N": n, "FJR_MEMORY": max(1, memory)}
    headers, sources = [*common_headers(), _text(f"{PART}.h")], [*common_sources(), _text(f"{PART}.c")]
    return Program(PART, headers, sources, values, library.text(library.HEADER))


def step_functions(program: Program, step: StepLibrary) -> dict[str, Any]:
    """Return the functions of the step as fields of struct fjr_step_functions."""
    functions = {name: step.ffi.addressof(step.lib, f"fjr_{name}") for name in FUNCTIONS}
    return program.cast("struct fjr_step_functions", functions)


def _text(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")
