# SPDX-License-Identifier: Apache-2.0
"""Find compiled code again without deriving anything: by what a function is made of, not by what it is.

jit.compiled needs the function to find its machine code, and a seven-joint arm's certificate takes a third of a
second to derive and write as C. What it is derived from, robot and gains, is read in milliseconds.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import casadi as ca

from .code_cache import code_folder, is_whole
from .jit import CompileError, compiled, machine, made

SOURCES = ("*.py", "*.c")
PACKAGE = Path(__file__).parents[1]


def recalled(name: str, model: bytes, pattern: str, build: Callable[[], ca.Function]) -> ca.Function:
    """Return compiled(build()); where that was done before for such a model and pattern, its machine code at once.

    model: fingerprint of what the function is derived from (Robot.fingerprint). pattern: all else that it depends on.
    This package's own source belongs to what is compared.
    """
    try:
        note, folder = _note(name, model, pattern), code_folder()
        found = (folder.read(note) or b"").decode("ascii", "replace")
        if found.startswith(f"{name}-") and "/" not in found and is_whole(folder, found):
            return ca.external(name, folder.within(found))
    except (CompileError, OSError, RuntimeError):
        return compiled(build())
    function, library = made(build())
    if library is not None:
        with suppress(OSError):
            code_folder().write(note, library.encode())
    return function


def program_digest(compiled: bool) -> str:
    """Digest of all but their input that kept results depend on: this package's source, CasADi, a compiler.

    compiled: whether the loop is machine code.
    """
    return hashlib.sha256(f"{source_digest()} {ca.__version__} {compiled}".encode()).hexdigest()


@cache
def source_digest(folder: Path = PACKAGE) -> str:
    """Digest of all Python and C in a folder, by default this package's, with the names of the files."""
    digest = hashlib.sha256()
    for path in sorted(path for pattern in SOURCES for path in folder.rglob(pattern)):
        digest.update(f"{path.relative_to(folder)} {path.stat().st_size}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _note(name: str, model: bytes, pattern: str) -> str:
    """Return the name of the file that holds the name of the machine code."""
    parts = [name, pattern, ca.__version__, source_digest(), *machine(), model.hex()]
    return f"{name}-{hashlib.sha256(chr(10).join(parts).encode()).hexdigest()[:32]}.note"
