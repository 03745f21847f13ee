# SPDX-License-Identifier: Apache-2.0
"""Compile CasADi functions and C files just in time, cache them by content or by their inputs, and call C by cffi.

The compiler is $CC, else one on the path, else the one in the distribution `ziglang` of PyPI.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import platform
import re
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import _cffi_backend
import casadi as ca
import numpy as np

from ..errors import PIP, CompilerError
from .code_cache import cache_folder, code_folder, is_intact, kept, read, write
from .symbolic import bind

NAMES = ("cc", "gcc", "clang")
REMEDY = f"expected one: apt-get install gcc libc6-dev, or {PIP} ziglang"
LONGEST_BUILD = 300.0  # s
SAME_BITS = ("-ffp-contract=off",)
"""Options without which results depend on the processor: no fused multiply-adds but those that the code names."""
OPTIONS = ("-O3", "-march=native", *SAME_BITS, "-fno-math-errno", "-fno-tree-slp-vectorize", "-fPIC", "-shared")
_log = logging.getLogger("fjr_core.numerics.jit")
SOURCES = (".py", ".c", ".h")
INCLUDED = ("#include <math.h>", "#include <stdint.h>", "#include <string.h>")
PACKAGE = Path(__file__).parents[1]
_NUMBER = re.compile(r"^#define (\w+) (\d+)\b.*$", re.MULTILINE)
_DIRECTIVE = re.compile(r"^#.*$", re.MULTILINE)


def c_compiler() -> tuple[str, ...]:
    """Return the command of the compiler; raise CompilerError, which names two remedies, if there is none."""
    try:
        wanted = shlex.split(os.environ.get("CC", ""))
    except ValueError as error:
        raise CompilerError(f"CC is {os.environ['CC']!r} ({error}); expected a command") from None
    for command in [wanted] if wanted else [[name] for name in NAMES]:
        found = shutil.which(command[0])
        if found:
            return (found, *command[1:])
    spec = None if wanted else find_spec("ziglang")  # its `cc` is clang with the headers of libc
    zig = Path(spec.origin).with_name("zig") if spec and spec.origin else None
    if zig and os.access(zig, os.X_OK):
        return (str(zig), "cc")
    raise CompilerError(f"no C compiler ({wanted[0] if wanted else ', '.join(NAMES)}) is on the path; {REMEDY}")


def run_compiler(command: Sequence[str]) -> None:
    """Run the compiler; raise CompilerError with its first error."""
    try:
        result = subprocess.run(
            command, capture_output=True, text=True, timeout=LONGEST_BUILD, check=False, env=_environment(command[0])
        )
    except OSError as error:
        raise CompilerError(f"{command[0]} cannot be started: {error.strerror}") from None
    except subprocess.TimeoutExpired:
        raise CompilerError(f"{command[0]} did not finish within {LONGEST_BUILD:g} s") from None
    if result.returncode:
        lines = [line for line in result.stderr.splitlines() if "error" in line] or ["no message"]
        raise CompilerError(f"{command[0]} failed: {lines[0]}")


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


def _environment(program: str) -> dict[str, str]:
    """Return the environment of the compiler; zig keeps what it builds from libc in the folder of compiled code."""
    if Path(program).name != "zig":
        return dict(os.environ)
    code_folder()
    folder = str(cache_folder() / "zig")
    return {"ZIG_GLOBAL_CACHE_DIR": folder, "ZIG_LOCAL_CACHE_DIR": folder, **os.environ}


def compiled(function: ca.Function) -> ca.Function:
    """Return the function compiled to machine code, or `function` itself if compilation is not possible.

    The name of the shared object in code_folder() is a hash of the C code, the compiler with its options and the
    processor; an intact file is only loaded. If two processes request the same code, one builds and the other waits.
    The result is not differentiable. The logger "fjr_core.numerics.jit" warns once if nothing is compiled; the function
    then runs in CasADi's virtual machine.
    """
    try:
        name = function.name()
        return external(name, _library(name, _c_code(name, [function])))
    except (CompilerError, OSError, RuntimeError) as error:
        _warn_once(str(error))
        return function


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
        return _library(name, source, options)
    except (CompilerError, OSError) as error:
        raise CompilerError(f"the {name.replace('_', ' ')} cannot be compiled: {error}") from None


def compiled_together(name: str, functions: Iterable[ca.Function]) -> list[ca.Function]:
    """Compile functions into one library, in one call of the compiler; raises CompilerError if that is not possible."""
    functions = list(functions)
    path = shared_object(name, _c_code(name, functions))
    return [external(function.name(), path) for function in functions]


def machine() -> list[str]:
    """Return what machine code depends on apart from the C code: compiler, options, processor, rewriting of the code.

    Raises CompilerError.
    """
    compiler = c_compiler()
    rewriting = hashlib.sha256(Path(__file__).with_name("fused_code.py").read_bytes()).hexdigest()
    return [*compiler, version(compiler), *OPTIONS, processor(), rewriting]


def _library(name: str, source: str, options: Sequence[str] = ()) -> str:
    """Find or build the shared object of a C source; return its path."""
    compiler = c_compiler()
    key = hashlib.sha256("\n".join([source, *machine(), *options]).encode())
    library = f"{name}-{key.hexdigest()[:32]}.so"
    return str(kept(library, lambda: _built(name, source, [*compiler, *OPTIONS], options)))


def _built(name: str, source: str, command: Sequence[str], options: Sequence[str]) -> bytes:
    """Compile in a temporary folder; return the content of the shared object."""
    from . import fused_code

    lines, where = source.count("\n"), cache_folder()
    _log.info("compiling %s (%d lines of C) in %s; this happens once and takes some seconds", name, lines, where)
    with tempfile.TemporaryDirectory() as folder:
        code, built = Path(folder, "code.c"), Path(folder, "code.so")
        code.write_text(fused_code.fused(source, fused_code.LONGEST), encoding="utf-8")
        run_compiler([*command, "-o", str(built), str(code), *options, "-lm"])
        if not built.exists():
            raise CompilerError(f"{command[0]} wrote no shared object")
        return built.read_bytes()


def _c_code(name: str, functions: Sequence[ca.Function]) -> str:
    generator = ca.CodeGenerator(name)
    try:
        for function in functions:
            generator.add(function)
        code = str(generator.dump())
    except RuntimeError as error:
        raise CompilerError(f"CasADi cannot write {name} as C: {error}") from None
    if "#error" in code:
        raise CompilerError(f"CasADi cannot write {name} as C")
    return code


@cache
def _warn_once(reason: str) -> None:
    _log.warning("%s; running in CasADi's virtual machine, equal up to rounding and some 20 times slower", reason)


def compiled_from_inputs(name: str, model: bytes, pattern: str, build: Callable[[], ca.Function]) -> ca.Function:
    """Return compiled(build()), or its cached machine code for the same model and pattern, without deriving it again.

    Deriving the certificate of a seven-joint arm and generating its C code takes a third of a second; hashing its
    inputs takes milliseconds.

    model: fingerprint of the robot (Robot.fingerprint). pattern: all other inputs of the function. The key also
    contains the source of this package.
    """
    try:
        parts = [name, pattern, ca.__version__, source_digest(), *machine(), model.hex()]
        note = code_folder() / f"{name}-{hashlib.sha256(chr(10).join(parts).encode()).hexdigest()[:32]}.note"
        found = (read(note) or b"").decode("ascii", "replace")
        if found.startswith(f"{name}-") and "/" not in found and is_intact(note.with_name(found)):
            return external(name, str(note.with_name(found)))
    except (CompilerError, OSError, RuntimeError):
        return compiled(build())
    function = compiled(build())
    if path := getattr(function, "shared_object", ""):
        with suppress(OSError):
            write(note, os.path.basename(path).encode())
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


def ffi_of(declarations: str) -> Any:
    """Return cffi's FFI for C declarations without preprocessor lines; its `dlopen` opens a library of them.

    To parse the header of the control step takes 30 to 50 ms. What cffi makes of it is Python code (its out-of-line ABI
    mode), executed in less than 1 ms. It is kept with the compiled code, and verified as that is.
    """
    key = hashlib.sha256(f"{_cffi_backend.__version__}\n{declarations}".encode())
    name = f"c_types-{key.hexdigest()[:32]}.py"
    found: dict[str, Any] = {}
    try:
        code = read(kept(name, lambda: _written(declarations)))
    except OSError:  # no folder can be written; that only costs time
        code = None
    exec(compile(code or _written(declarations), name, "exec"), found)
    return found["ffi"]


def record_type(ffi: Any, kind: Any) -> np.dtype[Any]:
    """Return NumPy's type with the layout of a type in C: numbers, arrays, and structures of them."""
    if kind.kind == "array":
        return np.dtype((record_type(ffi, kind.item), (kind.length,)))
    if kind.kind != "struct":
        return np.dtype("f8" if kind.cname == "double" else f"i{ffi.sizeof(kind)}")
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


def declarations(header: str, values: Mapping[str, int]) -> str:
    """Return a header as cffi reads it: without directives, and with the macros that are numbers replaced."""
    numbers = {**values, **{name: int(value) for name, value in _NUMBER.findall(header)}}
    for name, value in numbers.items():
        header = re.sub(rf"\b{name}\b", str(value), header)
    return _DIRECTIVE.sub("", header)


class CLibrary(NamedTuple):
    """A compiled library with cffi's types: `ffi` makes structures, `lib` holds the functions."""

    ffi: Any
    lib: Any
    path: str


def c_library(
    name: str, headers: str, sources: str, values: Mapping[str, int] = {}, options: Sequence[str] = ()
) -> CLibrary:
    """Compile C and open it by cffi, which reads the same headers, so that each structure stands once.

    headers, sources: their texts. values: macros that are numbers, defined before. options: of the compiler.
    Raises CompilerError.
    """
    defined = "".join(f"#define {macro} {value}\n" for macro, value in values.items())
    ffi, path = ffi_of(declarations(headers, values)), shared_object(name, f"{defined}{headers}\n{sources}", options)
    return CLibrary(ffi, ffi.dlopen(path), path)


def c_library_of(module: str, values: Mapping[str, int] = {}, options: Sequence[str] = ()) -> CLibrary:
    """Return the library of <module>.c with <module>.h; module: `__file__` of the Python module of the same name."""
    path = Path(module)
    header, code = (path.with_suffix(suffix).read_text(encoding="utf-8") for suffix in (".h", ".c"))
    return c_library(path.stem, "\n".join([*INCLUDED, header]), code, values, options)


MOST = 8  # arguments, and results, of a function that the C files call


class CFunction:
    """A CasADi function as a pointer of type fjr_function; it must outlive the C code that calls it.

    failed: called after each evaluation in Python; True if it failed. The pointer then returns 1.
    """

    def __init__(self, ffi: Any, function: ca.Function, failed: Any = None) -> None:
        self._ffi, self.function, self._failed = ffi, function, failed
        address = machine_code(function)
        if address is None:
            self._arguments = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
            self._results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
            self._trigger = bind(function, self._arguments, self._results)
            self.pointer = ffi.callback("fjr_function", self._evaluate, error=1)
        else:
            self.pointer = ffi.cast("fjr_function", address)

    def _evaluate(self, arg: Any, res: Any, _iw: Any, _w: Any, _mem: int) -> int:
        for i, argument in enumerate(self._arguments):
            if argument.size and arg[i] != self._ffi.NULL:
                argument[:] = np.frombuffer(self._ffi.buffer(arg[i], argument.nbytes))
        try:
            self._trigger()
        except RuntimeError:  # a root finder did not converge
            return 1
        for i, result in enumerate(self._results):
            if result.size and res[i] != self._ffi.NULL:
                np.frombuffer(self._ffi.buffer(res[i], result.nbytes))[:] = result
        return 1 if self._failed is not None and self._failed() else 0


class WorkSpace:
    """Memory for the temporary values of some functions in C."""

    def __init__(self, ffi: Any, functions: Sequence[ca.Function]) -> None:
        most = {size: max(1, *(getattr(f, f"sz_{size}")() for f in functions)) for size in ("arg", "res", "iw", "w")}
        self.arg = ffi.new("const double*[]", max(MOST, most["arg"]))
        self.res = ffi.new("double*[]", max(MOST, most["res"]))
        self.iw, self.w = ffi.new("long long[]", most["iw"]), ffi.new("double[]", most["w"])

    def lend(self, struct: Any) -> None:
        """Let a structure point to the memory."""
        for name in ("arg", "res", "iw", "w"):
            setattr(struct, name, getattr(self, name))
