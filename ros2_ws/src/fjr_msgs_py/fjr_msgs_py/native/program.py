# SPDX-License-Identifier: Apache-2.0
"""Build C code, against the ROS 2 of this process where it has a native thread, and open it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.errors import CompilerError
from fjr_core.numerics.jit import CLibrary, c_library

COMMON, THREAD = ("clock", "ring", "cdr"), ("loop", "graph")
"""Parts of every program, in the order in which they are included; those of THREAD need the headers of ROS 2."""
WARNINGS = ("-Wall", "-Wextra", "-Wno-unused-function")
_FEATURES = "#define _GNU_SOURCE\n#include <math.h>\n#include <string.h>\n"


class NativeError(Exception):
    """Reason why no native loop can be built; rclpy's executor runs instead."""


class Program:
    """A library in C, with that of this package, and its declarations.

    `lib` holds the functions, `ffi` makes their arguments.
    """

    without_thread = ""
    """Why the program has no native thread, so that rclpy's executor runs its functions; "" if it has one."""

    def __init__(
        self,
        name: str,
        headers: Sequence[str],
        sources: Sequence[str],
        values: Mapping[str, int] | None = None,
        base: str = "",
    ) -> None:
        """Build the library from the texts of headers and sources, or find it in the cache.

        values: macros that are numbers. base: C text that comes before the headers. Types of `ffi` are its own: `cast`
        makes them of pointers to the same types of another library. Raises CompilerError without a C compiler.
        """
        declared = [_FEATURES, base, *(_text(f"{part}.h") for part in (*COMMON, *THREAD)), *headers]

        def built(parts: Sequence[str], options: Sequence[str]) -> CLibrary:
            defined = [*(_text(f"{part}.c") for part in parts), *sources]
            return c_library(name, "\n".join(declared), "\n".join(defined), values or {}, [*WARNINGS, *options])

        try:
            self.ffi, self.lib, _ = built((*COMMON, *THREAD), ros_options())
        except (NativeError, CompilerError, OSError) as error:
            self.without_thread = str(error)
            self.ffi, self.lib, _ = built(COMMON, ())

    @classmethod
    def of(cls, package: str, files: Sequence[str], values: Mapping[str, int] | None = None, base: str = "") -> Program:
        """Build C files, headers and sources, of the folder native of a package."""
        headers, sources = ([_text(file, package) for file in files if file.endswith(kind)] for kind in (".h", ".c"))
        return cls(package, headers, sources, values, base)

    def array(self, values: np.ndarray) -> Any:
        """Return a pointer to the numbers of a contiguous array; it keeps the array alive."""
        kind = {"f": "double[]", "i": "int32_t[]" if values.itemsize == 4 else "int64_t[]"}[values.dtype.kind]
        return self.ffi.from_buffer(kind, values)

    def cast(self, struct: str, pointers: Mapping[str, Any]) -> dict[str, Any]:
        """Return pointers by the names of the fields of a structure, with the types of these fields."""
        types = dict(self.ffi.typeof(struct).fields)
        return {name: self.ffi.cast(types[name].type, pointer) for name, pointer in pointers.items()}


@cache
def ros_options() -> tuple[str, ...]:
    """Return the compiler's options for the headers and libraries of the ROS 2 that this process has loaded.

    Raise NativeError if its headers are not installed.
    """
    import rclpy.impl.implementation_singleton  # noqa: F401  # loads librcl

    mapped = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    prefix = next(Path(line[line.index("/") :]).parents[1] for line in mapped if "/librcl.so" in line)
    folders = sorted(folder for folder in (prefix / "include").glob("*") if (folder / folder.name).is_dir())
    if not (prefix / "include" / "rcl" / "rcl" / "rcl.h").is_file():
        raise NativeError(f"{prefix}/include/rcl is missing; expected the headers of ROS 2")
    return (*(f"-I{folder}" for folder in folders), f"-L{prefix / 'lib'}", "-lrcl", "-lrmw", "-lrcutils", "-lpthread")


def _text(name: str, package: str = "fjr_msgs_py") -> str:
    return (files(package) / "native" / name).read_text(encoding="utf-8")
