# SPDX-License-Identifier: Apache-2.0
"""Compile a C file that lies beside a Python module, call it by cffi, and give NumPy its types."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import _cffi_backend
import numpy as np

from . import jit
from .code_cache import kept

INCLUDED = ("#include <math.h>", "#include <stdint.h>", "#include <string.h>")


def ffi_of(declarations: str) -> Any:
    """Return cffi's FFI for C declarations without preprocessor lines; its `dlopen` opens a library of them.

    To parse the header of the control step takes 30 to 50 ms. What cffi makes of it is Python code (its out-of-line ABI
    mode), executed in less than 1 ms. It is kept with the compiled code, and verified as that is.
    """
    key = hashlib.sha256(f"{_cffi_backend.__version__}\n{declarations}".encode())
    name = f"c_types-{key.hexdigest()[:32]}.py"
    found: dict[str, Any] = {}
    try:
        code = kept(name, lambda: _written(declarations)).read(name)
    except OSError:  # no folder can be written; that only costs time
        code = None
    exec(compile(code or _written(declarations), name, "exec"), found)
    return found["ffi"]


def record_type(ffi: Any, kind: Any) -> np.dtype[Any]:
    """Return NumPy's type with the layout of a type in C: numbers, arrays, and structures of them."""
    if kind.kind == "array":
        return np.dtype((record_type(ffi, kind.item), (kind.length,)))
    if kind.kind != "struct":
        number = "f8" if kind.cname == "double" else f"i{ffi.sizeof(kind)}"
        return np.dtype(number)
    fields = dict(kind.fields)
    return np.dtype(
        {
            "names": list(fields),
            "formats": [record_type(ffi, field.type) for field in fields.values()],
            "offsets": [field.offset for field in fields.values()],
            "itemsize": ffi.sizeof(kind),
        }
    )


def _written(declarations: str) -> bytes:
    """Return the Python code that cffi writes for declarations."""
    from cffi import FFI
    from cffi.recompiler import make_py_source

    ffi = FFI()
    ffi.set_source("c_types", None)
    ffi.cdef(declarations)
    with tempfile.TemporaryDirectory() as folder:
        code = Path(folder, "c_types.py")
        make_py_source(ffi, "c_types", str(code))
        return code.read_bytes()


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
