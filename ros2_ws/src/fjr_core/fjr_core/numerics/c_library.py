# SPDX-License-Identifier: Apache-2.0
"""Compile a C file that lies beside a Python module, and call it by cffi."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from . import jit
from .c_types import ffi_of

INCLUDED = ("#include <math.h>", "#include <stdint.h>", "#include <string.h>")


def c_library(module: str, sizes: Mapping[str, int] = {}, options: Sequence[str] = ()) -> tuple[Any, Any]:
    """Return cffi's types and the library of <module>.c, whose declarations are in <module>.h.

    module: `__file__` of the Python module of the same name. sizes: macros of the code; options: of the compiler.
    Raises CompilerError.
    """
    path = Path(module)
    header, code = (path.with_suffix(suffix).read_text(encoding="utf-8") for suffix in (".h", ".c"))
    defined = [f"#define {name} {size}" for name, size in sizes.items()]
    ffi = ffi_of(header)
    return ffi, ffi.dlopen(jit.shared_object(path.stem, "\n".join([*INCLUDED, *defined, header, code]), options))
