# SPDX-License-Identifier: Apache-2.0
"""Look up compiled functions by their inputs (robot, gain pattern), so that nothing has to be derived again.

jit.compiled needs the function itself to find its machine code. Deriving the certificate of a seven-joint arm and
generating its C code takes a third of a second; hashing its inputs takes milliseconds.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import casadi as ca

from .code_cache import code_folder, is_intact
from .jit import CompileError, compile_named, compiled, external, machine

SOURCES = (".py", ".c", ".h")
PACKAGE = Path(__file__).parents[1]


def compiled_from_inputs(name: str, model: bytes, pattern: str, build: Callable[[], ca.Function]) -> ca.Function:
    """Return compiled(build()), or its cached machine code for the same model and pattern.

    model: fingerprint of the robot (Robot.fingerprint). pattern: all other inputs of the function. The key also
    contains the source of this package.
    """
    try:
        note, folder = _note(name, model, pattern), code_folder()
        found = (folder.read(note) or b"").decode("ascii", "replace")
        if found.startswith(f"{name}-") and "/" not in found and is_intact(folder, found):
            return external(name, folder.within(found))
    except (CompileError, OSError, RuntimeError):
        return compiled(build())
    function, library = compile_named(build())
    if library is not None:
        with suppress(OSError):
            code_folder().write(note, library.encode())
    return function


def program_digest(*folders: Path) -> str:
    """Return a cache key for results: hash of the source of this package and of folders, and the CasADi version."""
    sources = " ".join(map(source_digest, (PACKAGE, *folders)))
    return hashlib.sha256(f"{sources} {ca.__version__}".encode()).hexdigest()


@cache
def source_digest(folder: Path = PACKAGE) -> str:
    """Return a hash of all Python and C files in a folder with their names; by default this package.

    Without pathlib: each start of a node waits for it.
    """
    digest = hashlib.sha256()
    files = (os.path.join(base, name) for base, _, names in os.walk(folder) for name in names)
    for path in sorted(path for path in files if path.endswith(SOURCES)):
        with open(path, "rb") as stream:
            content = stream.read()
        digest.update(f"{path.removeprefix(str(folder))} {len(content)}\n".encode() + content)
    return digest.hexdigest()


def _note(name: str, model: bytes, pattern: str) -> str:
    """Return the name of the file that stores the name of the shared object."""
    parts = [name, pattern, ca.__version__, source_digest(), *machine(), model.hex()]
    return f"{name}-{hashlib.sha256(chr(10).join(parts).encode()).hexdigest()[:32]}.note"
