# SPDX-License-Identifier: Apache-2.0
"""CasADi functions as machine code: C from CasADi, a shared object from the machine's compiler, cached by content."""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import casadi as ca

from ..files.private_folder import PrivateFolder
from .code_cache import code_folder, is_whole, keep, temporary_folder

OPTIONS = ("-O3", "-march=native", "-fPIC", "-shared")
COMPILERS = ("cc", "gcc", "clang")
LONGEST_BUILD = 300.0  # s

_log = logging.getLogger("fjr_core.numerics.jit")


class CompileError(Exception):
    """Why a function cannot be compiled here; never leaves this module."""


def compiled(function: ca.Function) -> ca.Function:
    """The same function as machine code; `function` itself, run by CasADi's virtual machine, where that cannot be.

    The C code, the compiler with its options and the processor decide the name of the shared object in
    code_folder(); one that is there as it was kept is only loaded. Two processes may build at once: one builds, the
    other waits. Derivatives of the result are not available. Says once, as a warning of the logger
    "fjr_core.numerics.jit", why nothing is compiled.
    """
    return made(function)[0]


def made(function: ca.Function) -> tuple[ca.Function, str | None]:
    """Compile a function; return it with the name of its file in code_folder(), None where nothing was compiled."""
    try:
        name = function.name()
        folder, library = _library(name, _c_code(name, [function]))
        return ca.external(name, folder.within(library)), library
    except (CompileError, OSError, RuntimeError, ValueError) as error:
        _say_once(str(error))
        return function, None


def loaded(name: str, functions: Sequence[ca.Function], around: Callable[[str], str]) -> ctypes.CDLL | None:
    """A program of C round the C code of CasADi functions, as a loaded library; None, said once, where it cannot be.

    around: from CasADi's code to the whole source. Cached as machine code of a function is.
    """
    try:
        folder, library = _library(name, around(_c_code(name, functions)))
        return ctypes.CDLL(folder.within(library))
    except (CompileError, OSError, RuntimeError, ValueError) as error:
        _say_once(str(error))
        return None


def machine() -> list[str]:
    """What decides, beside the C code, what machine code is made: compiler, options, processor; CompileError."""
    compiler = _compiler()
    return [*compiler, _version(compiler), *OPTIONS, _processor()]


def can_compile() -> bool:
    """Whether a C compiler is here."""
    try:
        return bool(_compiler())
    except CompileError:
        return False


def _library(name: str, source: str) -> tuple[PrivateFolder, str]:
    """The shared object of a C source, found or built: its folder and its name there."""
    compiler = _compiler()
    key = hashlib.sha256("\n".join([source, *machine()]).encode())
    stem = f"{name}-{key.hexdigest()[:32]}"
    folder = code_folder()
    try:
        return folder, _ensured(folder, stem, source, compiler)
    except OSError as error:  # it cannot be written
        folder = temporary_folder(f"cannot write to {folder.path} ({error.strerror or error})")
        return folder, _ensured(folder, stem, source, compiler)


def _ensured(folder: PrivateFolder, stem: str, source: str, compiler: tuple[str, ...]) -> str:
    """Build the library unless it is there whole, or while this waits another process does; its name."""
    library = f"{stem}.so"
    if is_whole(folder, library):
        return library
    with folder.locked(f"{stem}.lock"):
        if not is_whole(folder, library):
            lines, what = source.count("\n"), stem.rpartition("-")[0]
            _log.info("making machine code of %s (%d lines of C) in %s: once, some seconds", what, lines, folder.path)
            keep(folder, library, _built(source, compiler))
    return library


def _built(source: str, compiler: tuple[str, ...]) -> bytes:
    """The content of the shared object, compiled in a temporary folder of this user's."""
    with tempfile.TemporaryDirectory() as folder:
        code, made = Path(folder, "code.c"), Path(folder, "code.so")
        code.write_text(source, encoding="utf-8")
        _run([*compiler, *OPTIONS, "-o", str(made), str(code), "-lm"])
        if not made.exists():
            raise CompileError(f"{compiler[0]} wrote no shared object")
        return made.read_bytes()


def _run(command: list[str]) -> None:
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_BUILD, check=False)
    except OSError as error:
        raise CompileError(f"{command[0]} cannot be started: {error.strerror}") from None
    except subprocess.TimeoutExpired:
        raise CompileError(f"{command[0]} did not finish within {LONGEST_BUILD:g} s") from None
    if result.returncode:
        lines = [line for line in result.stderr.splitlines() if "error" in line] or ["no message"]
        raise CompileError(f"{command[0]} failed: {lines[0]}")


def _c_code(name: str, functions: Sequence[ca.Function]) -> str:
    generator = ca.CodeGenerator(name)
    for function in functions:
        generator.add(function)
    code = str(generator.dump())
    if "#error" in code:
        raise CompileError(f"CasADi cannot write {name} as C")
    return code


def _compiler() -> tuple[str, ...]:
    """$CC, or the first compiler on the path; raises CompileError when there is none."""
    wanted = shlex.split(os.environ.get("CC", ""))
    for command in [wanted] if wanted else [[name] for name in COMPILERS]:
        found = shutil.which(command[0])
        if found:
            return (found, *command[1:])
    names = wanted[0] if wanted else ", ".join(COMPILERS)
    raise CompileError(f"no C compiler ({names}) is on the path: install one, e.g. apt-get install gcc libc6-dev")


@cache
def _version(compiler: tuple[str, ...]) -> str:
    result = subprocess.run([*compiler, "--version"], capture_output=True, text=True, check=False)
    return result.stdout


@cache
def _processor() -> str:
    """What -march=native depends on: a cache may be shared by machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    told = {line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))}
    return "\n".join([platform.machine(), *sorted(told)])


@cache
def _say_once(reason: str) -> None:
    _log.warning("%s; running in CasADi's virtual machine, with the same numbers, some 20 times slower", reason)
