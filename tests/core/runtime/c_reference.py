# SPDX-License-Identifier: Apache-2.0
"""Build reference.c as a library, with warnings as errors, and evaluate references in it."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cffi import FFI

import fjr_core
from design.exports.c_program import built
from fjr_core.motions.reference import JETS, Reference
from fjr_core.runtime.reference import ReferenceStruct

STEP = Path(fjr_core.__file__).parent / "runtime"
STRICT = ("cc", "-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-ffp-contract=off")
EXPORTED = """
void many(const struct fjr_reference* r, int64_t k, const double* t, double* jets);
int segment(struct fjr_segment* s, const double* jets0, const double* jets1, double t0, double t1);
void along(const struct fjr_segment* s, int64_t k, const double* t, double* jets);
const struct fjr_reference* constant(int64_t i);
"""
WRAPPERS = """
void many(const struct fjr_reference* r, int64_t k, const double* t, double* jets) {
  for (int64_t i = 0; i < k; ++i) fjr_reference_jets(r, t[i], jets + i * FJR_JETS * FJR_N);
}
int segment(struct fjr_segment* s, const double* jets0, const double* jets1, double t0, double t1) {
  return make_segment(s, jets0, jets1, t0, t1);
}
void along(const struct fjr_segment* s, int64_t k, const double* t, double* jets) {
  for (int64_t i = 0; i < k; ++i) segment_jets(s, t[i], jets + i * FJR_JETS * FJR_N);
}
const struct fjr_reference* constant(int64_t i) { return constants[i]; }
"""


class Library(NamedTuple):
    """reference.c for n joints."""

    n: int
    ffi: FFI
    lib: Any

    def jets(self, reference: Reference, t: Any) -> np.ndarray:
        """Return the jets (k, 5, n) of a reference at times (k,)."""
        struct = ReferenceStruct(self.ffi, reference)
        jets = self.at(struct.pointer, t)
        struct.raise_failure()
        return jets

    def at(self, pointer: Any, t: Any) -> np.ndarray:
        """Return the jets (k, 5, n) of a struct fjr_reference at times (k,)."""
        return self._filled(self.lib.many, pointer, t)

    def segment(self, jets0: np.ndarray, jets1: np.ndarray, t0: float, t1: float) -> Any | None:
        """Return a struct fjr_segment, or None if it is not finite."""
        made = self.ffi.new("struct fjr_segment *")
        return made if self.lib.segment(made, self._doubles(jets0), self._doubles(jets1), t0, t1) else None

    def along(self, segment: Any, t: Any) -> np.ndarray:
        """Return the jets (k, 5, n) of a segment at times (k,)."""
        return self._filled(self.lib.along, segment, t)

    def _filled(self, function: Any, pointer: Any, t: Any) -> np.ndarray:
        jets = np.empty((len(t), JETS, self.n))
        function(pointer, len(t), self._doubles(t), self.ffi.from_buffer("double[]", jets))
        return jets

    def _doubles(self, array: Any) -> Any:
        return self.ffi.from_buffer("double[]", np.ascontiguousarray(array, dtype=float))


def library(n: int, constants: Sequence[str] = (), code: str = "") -> Library:
    """Return reference.c for n joints; constants: names of references in `code`, read by `constant`."""
    rows = ", ".join(f"&{name}" for name in constants) or "0"
    table = f"static const struct fjr_reference* const constants[] = {{{rows}}};"
    text = (STEP / "reference.c").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        source, shared = Path(folder, "reference.c"), Path(folder, "reference.so")
        parts = ('#include "step.h"', EXPORTED, text, code, table, WRAPPERS)
        source.write_text("\n".join(parts), encoding="utf-8")
        options = ("-shared", "-fPIC", f"-DFJR_N={n}", "-DFJR_MEMORY=1", f"-I{STEP}")
        built(STRICT, [source], shared, *options)
        ffi = FFI()
        ffi.cdef(declarations(n) + EXPORTED)
        return Library(n, ffi, ffi.dlopen(str(shared)))


def declarations(n: int) -> str:
    """Return step.h for n joints without preprocessor lines."""
    text = (STEP / "step.h").read_text(encoding="utf-8")
    numbers = {"FJR_N": str(n), "FJR_MEMORY": "1", **dict(re.findall(r"^#define (FJR_\w+) (\d+)", text, re.MULTILINE))}
    plain = re.sub(r"^#.*$", "", text, flags=re.MULTILINE)
    return re.sub(r"\bFJR_\w+", lambda name: numbers.get(name[0], name[0]), plain)
