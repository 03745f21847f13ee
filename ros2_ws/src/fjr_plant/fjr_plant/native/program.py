# SPDX-License-Identifier: Apache-2.0
"""Build the C of this folder and open it."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np

from fjr_core.numerics.c_library import ffi_of
from fjr_core.numerics.jit import shared_object
from fjr_core.runtime.library import declarations
from fjr_msgs_py.native.program import COMMON, NativeError, Program, common_headers, common_sources

HEADERS = ("robot.h", "channel.h", "plant.h")
SOURCES = ("robot.c", "channel.c", "time_base.c", "real_time.c", "lock_step.c")
LOOP = "plant_loop"
NO_TIME = 2**63 - 1
"""FJR_NO_TIME."""
_MESSAGES = "cdr"  # the part of the common sources that needs no headers of ROS 2


class PlantProgram(NamedTuple):
    """The compiled plant: `lib` holds the functions, `ffi` makes their arguments.

    loop: the same with the native host; None where that cannot be built, for the reason `without_loop`.
    """

    ffi: Any
    lib: Any
    loop: Program | None
    without_loop: str


@cache
def plant_program() -> PlantProgram:
    """Return the program of this process, compiled and cached; raises CompilerError without a C compiler."""
    headers, sources = ([_text(name) for name in names] for names in (HEADERS, SOURCES))
    try:
        loop = Program(
            "fjr_plant",
            [*common_headers(), *headers, _text(f"{LOOP}.h")],
            [*common_sources(), *sources, _text(f"{LOOP}.c")],
        )
    except NativeError as error:
        return _without_loop(headers, sources, str(error))
    return PlantProgram(loop.ffi, loop.lib, loop, "")


def _without_loop(headers: list[str], sources: list[str], why: str) -> PlantProgram:
    headers = [*common_headers(), *headers]
    messages = common_sources()[COMMON.index(_MESSAGES)]
    path = shared_object(
        "fjr_plant", "\n".join(["#include <math.h>\n#include <string.h>", *headers, messages, *sources])
    )
    ffi = ffi_of(declarations("\n".join(headers), {}))
    return PlantProgram(ffi, ffi.dlopen(path), None, why)


def array(program: PlantProgram, values: np.ndarray) -> Any:
    """Return a pointer to the numbers of a contiguous array; it keeps the array alive."""
    kind = {"f": "double[]", "i": "int32_t[]" if values.itemsize == 4 else "int64_t[]"}[values.dtype.kind]
    return program.ffi.from_buffer(kind, values)


def _text(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")
