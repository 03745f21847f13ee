# SPDX-License-Identifier: Apache-2.0
"""Find and run the C compiler: $CC, else one on the path, else the one in the distribution `ziglang` of PyPI."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from .code_cache import code_folder

NAMES = ("cc", "gcc", "clang")
REMEDY = "expected one: apt-get install gcc libc6-dev, or pip install ziglang"
LONGEST_BUILD = 300.0  # s


class CompileError(Exception):
    """Reason why a function cannot be compiled; handled inside numerics."""


def c_compiler() -> tuple[str, ...]:
    """Return the command of the compiler; raise CompileError if there is none."""
    wanted = shlex.split(os.environ.get("CC", ""))
    for command in [wanted] if wanted else [[name] for name in NAMES]:
        found = shutil.which(command[0])
        if found:
            return (found, *command[1:])
    zig = None if wanted else _zig()
    if zig:
        return (zig, "cc")
    raise CompileError(f"no C compiler ({wanted[0] if wanted else ', '.join(NAMES)}) is on the path; {REMEDY}")


def run_compiler(command: Sequence[str]) -> None:
    """Run the compiler; raise CompileError with its first error."""
    try:
        result = subprocess.run(
            command, capture_output=True, text=True, timeout=LONGEST_BUILD, check=False, env=_environment(command[0])
        )
    except OSError as error:
        raise CompileError(f"{command[0]} cannot be started: {error.strerror}") from None
    except subprocess.TimeoutExpired:
        raise CompileError(f"{command[0]} did not finish within {LONGEST_BUILD:g} s") from None
    if result.returncode:
        lines = [line for line in result.stderr.splitlines() if "error" in line] or ["no message"]
        raise CompileError(f"{command[0]} failed: {lines[0]}")


@cache
def version(compiler: tuple[str, ...]) -> str:
    """Return what the compiler prints about its version."""
    command, env = [*compiler, "--version"], _environment(compiler[0])
    return subprocess.run(command, capture_output=True, text=True, check=False, env=env).stdout


@cache
def processor() -> str:
    """Return the processor properties that -march=native depends on; machines may share a cache."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    properties = {line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))}
    return "\n".join([platform.machine(), *sorted(properties)])


def _zig() -> str | None:
    """Return the program in the distribution `ziglang`, whose `cc` is clang with the headers of libc."""
    spec = find_spec("ziglang")
    program = Path(spec.origin).with_name("zig") if spec and spec.origin else None
    return str(program) if program and os.access(program, os.X_OK) else None


def _environment(program: str) -> dict[str, str]:
    """Return the environment of the compiler; zig keeps what it builds from libc in the folder of compiled code."""
    if Path(program).name != "zig":
        return dict(os.environ)
    folder = str(code_folder().path / "zig")
    return {"ZIG_GLOBAL_CACHE_DIR": folder, "ZIG_LOCAL_CACHE_DIR": folder, **os.environ}
