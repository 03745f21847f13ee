# SPDX-License-Identifier: Apache-2.0
"""Compile CasADi functions just in time: generate C, build a shared object, cache it by content."""

from __future__ import annotations

import ctypes
import hashlib
import logging
import tempfile
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

import casadi as ca

from ..errors import CompilerError
from ..files.private_folder import PrivateFolder
from . import fused_code
from .c_compiler import CompileError, c_compiler, processor, run_compiler, version
from .code_cache import code_folder, is_intact, keep, temporary_folder

SAME_BITS = ("-ffp-contract=off",)
"""Options without which results depend on the processor: no fused multiply-adds but those that the code names."""
OPTIONS = ("-O3", "-march=native", *SAME_BITS, "-fno-math-errno", "-fno-tree-slp-vectorize", "-fPIC", "-shared")

_log = logging.getLogger("fjr_core.numerics.jit")


def compiled(function: ca.Function) -> ca.Function:
    """Return the function compiled to machine code, or `function` itself if compilation is not possible.

    The name of the shared object in code_folder() is a hash of the C code, the compiler with its options and the
    processor; an intact file is only loaded. If two processes request the same code, one builds and the other waits.
    The result is not differentiable. The logger "fjr_core.numerics.jit" warns once if nothing is compiled; the function
    then runs in CasADi's virtual machine.
    """
    return compile_named(function)[0]


def compile_named(function: ca.Function) -> tuple[ca.Function, str | None]:
    """Compile a function; return it with the name of its file in code_folder(), or None if it was not compiled."""
    try:
        name = function.name()
        folder, library = _library(name, _c_code(name, [function]))
        return external(name, folder.within(library)), library
    except (CompileError, OSError, RuntimeError, ValueError) as error:
        _warn_once(str(error))
        return function, None


def external(name: str, path: str) -> ca.Function:
    """Return the function of this name in a shared object; it knows its path (machine_code)."""
    function = ca.external(name, path)
    function.shared_object = path
    return function


def machine_code(function: ca.Function) -> int | None:
    """Return the address of a function compiled here, with CasADi's signature in C; None if it is not compiled."""
    path = getattr(function, "shared_object", None)
    if path is None:
        return None
    return ctypes.cast(getattr(ctypes.CDLL(path), function.name()), ctypes.c_void_p).value


def shared_object(name: str, source: str, options: Sequence[str] = ()) -> str:
    """Return the path of the shared object built from a C source, cached as compiled functions are.

    options: of the compiler, after its usual ones. Raises CompilerError if there is no C compiler or it fails.
    """
    try:
        folder, library = _library(name, source, options)
        return folder.within(library)
    except (CompileError, OSError) as error:
        raise CompilerError(f"the {name.replace('_', ' ')} cannot be compiled: {error}") from None


def compiled_together(name: str, functions: Iterable[ca.Function]) -> list[ca.Function]:
    """Compile functions into one library, in one call of the compiler; raises CompilerError if that is not possible."""
    functions = list(functions)
    try:
        path = shared_object(name, _c_code(name, functions))
    except (CompileError, RuntimeError, ValueError) as error:
        raise CompilerError(f"the {name.replace('_', ' ')} cannot be compiled: {error}") from None
    return [external(function.name(), path) for function in functions]


def machine() -> list[str]:
    """Return what machine code depends on apart from the C code: compiler, options, processor, rewriting of the code.

    Raises CompileError.
    """
    compiler = c_compiler()
    rewriting = hashlib.sha256(Path(fused_code.__file__).read_bytes()).hexdigest()
    return [*compiler, version(compiler), *OPTIONS, processor(), rewriting]


def require_compiler() -> None:
    """Raise CompilerError, which names two remedies, if there is no C compiler."""
    try:
        c_compiler()
    except CompileError as error:
        raise CompilerError(str(error)) from None


def _library(name: str, source: str, options: Sequence[str] = ()) -> tuple[PrivateFolder, str]:
    """Find or build the shared object of a C source; return its folder and its name."""
    compiler = c_compiler()
    key = hashlib.sha256("\n".join([source, *machine(), *options]).encode())
    stem = f"{name}-{key.hexdigest()[:32]}"
    folder = code_folder()
    try:
        return folder, _ensured(folder, stem, source, compiler, options)
    except OSError as error:  # the folder is not writable
        folder = temporary_folder(f"cannot write to {folder.path} ({error.strerror or error})")
        return folder, _ensured(folder, stem, source, compiler, options)


def _ensured(folder: PrivateFolder, stem: str, source: str, compiler: tuple[str, ...], options: Sequence[str]) -> str:
    """Build the library unless it is intact or another process builds it meanwhile; return its name."""
    library = f"{stem}.so"
    if is_intact(folder, library):
        return library
    with folder.locked(f"{stem}.lock"):
        if not is_intact(folder, library):
            lines, what = source.count("\n"), stem.rpartition("-")[0]
            _log.info(
                "compiling %s (%d lines of C) in %s; this happens once and takes some seconds", what, lines, folder.path
            )
            keep(folder, library, _built(source, compiler, options))
    return library


def _built(source: str, compiler: tuple[str, ...], options: Sequence[str]) -> bytes:
    """Compile in a temporary folder; return the content of the shared object."""
    with tempfile.TemporaryDirectory() as folder:
        code, built = Path(folder, "code.c"), Path(folder, "code.so")
        code.write_text(fused_code.fused(source, fused_code.LONGEST), encoding="utf-8")
        run_compiler([*compiler, *OPTIONS, "-o", str(built), str(code), *options, "-lm"])
        if not built.exists():
            raise CompileError(f"{compiler[0]} wrote no shared object")
        return built.read_bytes()


def _c_code(name: str, functions: Sequence[ca.Function]) -> str:
    generator = ca.CodeGenerator(name)
    for function in functions:
        generator.add(function)
    code = str(generator.dump())
    if "#error" in code:
        raise CompileError(f"CasADi cannot write {name} as C")
    return code


@cache
def _warn_once(reason: str) -> None:
    _log.warning("%s; running in CasADi's virtual machine, equal up to rounding and some 20 times slower", reason)
