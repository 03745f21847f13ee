# SPDX-License-Identifier: Apache-2.0
"""Machine code found again without deriving anything: by what a function would be made of, not by what it is.

compile.compiled needs the function to find its machine code, and a seven-joint arm's certificate takes a third of a
second to derive and write as C. What it is derived from, robot and gains, is read in milliseconds.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np

from ..robot.robot import Robot
from .code_cache import code_folder, is_whole
from .jit import CompileError, compiled, machine, made

LINKS = ("M_l", "P_l", "grad_P_l", "C", "grad_T")
MATRICES = ("M_m", "K", "D_l", "D_m", "B_m")


def recalled(name: str, robot: Robot, pattern: str, build: Callable[[], ca.Function]) -> ca.Function:
    """compiled(build()); where that was done before for such a robot and pattern, its machine code at once.

    pattern: all else that the function depends on. This package's own source belongs to what is compared.
    """
    try:
        note, folder = _note(name, robot, pattern), code_folder()
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


def _note(name: str, robot: Robot, pattern: str) -> str:
    """The name of the file that holds the name of the machine code."""
    parts = [name, pattern, ca.__version__, _source(), *machine()]
    parts += [getattr(robot.links, field).serialize() for field in LINKS]
    digest = hashlib.sha256("\n".join(parts).encode())
    for field in MATRICES:
        digest.update(np.ascontiguousarray(getattr(robot, field)).tobytes())
    return f"{name}-{digest.hexdigest()[:32]}.note"


@cache
def _source() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
