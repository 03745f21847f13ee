# SPDX-License-Identifier: Apache-2.0
"""C declarations are parsed once; what is kept is verified before it is executed."""

from __future__ import annotations

from pathlib import Path

import pytest
from cffi import FFI

from core.numerics.processes import output, started
from fjr_core.numerics.jit import declarations, ffi_of
from fjr_core.runtime.library import HEADER, sizes, text

pytestmark = pytest.mark.usefixtures("cache")
STEP = declarations(text(HEADER), sizes(3, 2))
STRUCTS = ("controller", "model", "settings", "sample", "command", "reference")
READ = """
import sys
from fjr_core.numerics.jit import ffi_of
assert ffi_of("struct point { double x, y; };").sizeof("struct point") == 16
print("pycparser" in sys.modules)
"""


def layout(ffi: FFI) -> dict[str, object]:
    """Return offset and type of each field, and the enumerations."""
    fields = {
        f"{name}.{field}": (found.offset, found.type.cname)
        for name in STRUCTS
        for field, found in ffi.typeof(f"struct fjr_{name}").fields
    }
    return {**fields, "kinds": ffi.typeof("enum fjr_kind").elements}


def test_kept_types_are_those_that_cffi_parses() -> None:
    parsed = FFI()
    parsed.cdef(STEP)
    for _ in range(2):  # written, then kept
        assert layout(ffi_of(STEP)) == layout(parsed)


def test_second_process_does_not_parse() -> None:
    assert [output(started(READ)).strip() for _ in range(2)] == ["True", "False"]


def test_changed_code_is_not_executed(cache: Path) -> None:
    ffi_of(STEP)
    (kept,) = cache.glob("c_types-*.py")
    kept.write_text("raise AssertionError")
    assert ffi_of(STEP).sizeof("struct fjr_sample") == 8 * (1 + 4 * 3)


def test_folder_that_is_not_writable_only_costs_time(cache: Path) -> None:
    cache.parent.mkdir()
    cache.write_text("a file in place of the folder")
    assert ffi_of(STEP).sizeof("struct fjr_sample") == 8 * (1 + 4 * 3)
