# SPDX-License-Identifier: Apache-2.0
"""Write C text: CasADi functions with a prefix, arrays of numbers, names, and templates filled with them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape

import casadi as ca
import numpy as np
import yaml
from numpy.typing import ArrayLike

from fjr_core.errors import ParameterError
from fjr_core.numerics.fused_code import fused

if TYPE_CHECKING:
    from jinja2 import Environment

LONGEST_PREFIX = 40  # characters
_TARGETS = (
    "all all_build clean depend edit_cache help install list_install_components package package_source preinstall "
    "rebuild_cache run_tests test zero_check"
)
_HEADERS = (
    "alloca assert complex ctype endian errno features fenv float inttypes iso646 limits locale math memory setjmp "
    "signal stdalign stdarg stdatomic stdbool stddef stdint stdio stdlib stdnoreturn string strings tgmath threads "
    "time uchar unistd wchar wctype"
)
RESERVED = frozenset(f"{_TARGETS} {_HEADERS} replay case c m".split())
"""Names, in lower case, that collide with <prefix>.h, <prefix>.c or the CMake target <prefix>."""
ON_A_LINE = 6  # numbers of a table

_HEAD = """\
/* Made by CasADi {version}, https://web.casadi.org. All functions have one signature: some arguments are unused.
 * fma(a, b, c) is a b + c, rounded once: the same result from the instruction of a processor and from the C library. */
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
#include <math.h>
/* Compiled for any x86, the functions use the instruction where the processor has it. */
#if defined(__x86_64__) && !defined(__FMA__) && defined(__GNUC__) && !defined(__clang__) && defined(__GLIBC__)
#define CASADI_FUSED __attribute__((target_clones("fma", "default")))
#else
#define CASADI_FUSED
#endif
"""


def prefix_of(name: str) -> str:
    """Convert a name to a prefix of C identifiers: "arm-7 b" gives arm_7_b."""
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")[:LONGEST_PREFIX]
    if plain[:1].isalpha() and plain.lower() not in RESERVED:
        return plain
    return f"loop_{plain}"[:LONGEST_PREFIX].rstrip("_")


def checked_prefix(prefix: str) -> str:
    """Return a prefix that is valid for C identifiers and file names; raises ParameterError for any other."""
    if not re.fullmatch(rf"[A-Za-z][A-Za-z0-9_]{{0,{LONGEST_PREFIX - 1}}}", prefix):
        raise ParameterError(
            f"prefix is '{prefix}'; expected a letter, then letters, digits or '_', at most {LONGEST_PREFIX}"
        )
    if prefix.lower() in RESERVED:
        raise ParameterError(
            f"prefix is '{prefix}', which is a name of C headers, CMake or the export; expected another one"
        )
    return prefix


def casadi_code(prefix: str, functions: Mapping[str, ca.Function]) -> str:
    """Return one C file with the functions as <prefix>_casadi_<name>, without static memory."""
    generator = ca.CodeGenerator(f"{prefix}_casadi", {"include_math": True, "indent": 2})
    for name, function in functions.items():
        generator.add(renamed(function, f"{prefix}_casadi_{name}"))
    code = str(generator.dump())
    if "#error" in code:
        raise ParameterError(
            f"CasADi cannot generate C for one of {', '.join(functions)}; expected functions that it supports"
        )
    code = re.sub("^static int ", "CASADI_FUSED static int ", fused(code), flags=re.MULTILINE)
    return _HEAD.format(version=ca.__version__) + code


def renamed(function: ca.Function, name: str) -> ca.Function:
    """Return a function under another name."""
    return function.slice(name, list(range(function.n_in())), list(range(function.n_out())))


def work_sizes(prefix: str, functions: Mapping[str, ca.Function]) -> dict[str, int]:
    """Return the sizes arg, res, iw, w (1 or more) of a work space for any of the functions of casadi_code."""
    all_ = [renamed(function, f"{prefix}_casadi_{name}") for name, function in functions.items()]
    return {size: max(1, *(getattr(f, f"sz_{size}")() for f in all_)) for size in ("arg", "res", "iw", "w")}


def numbers(values: ArrayLike) -> str:
    """Format the entries of an array of doubles exactly; an empty array gives 0.0, since C has no empty arrays."""
    flat = [number(value) for value in np.ravel(values).astype(float).tolist()] or ["0.0"]
    lines = [", ".join(flat[i : i + ON_A_LINE]) for i in range(0, len(flat), ON_A_LINE)]
    return ",\n    ".join(lines)


def number(value: float) -> str:
    """Format a double exactly for C with math.h."""
    return repr(value) if math.isfinite(value) else "NAN" if math.isnan(value) else f"{'-' * (value < 0)}INFINITY"


def quoted(text: str) -> str:
    """Format a string literal; bytes that are not plain ASCII are escaped in octal."""
    plain = [chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in text.encode()]
    return f'"{"".join(plain)}"'


def comment(text: str) -> str:
    """Format a text for one line of a C comment."""
    return " ".join(text.split()).replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


@cache
def _environment() -> Environment:
    """Return the Jinja2 environment of the templates: @{value} and @% statement %@, since C and Markdown use braces."""
    from jinja2 import Environment, StrictUndefined  # a tenth of a second, only where files are exported

    made = Environment(
        variable_start_string="@{",
        variable_end_string="}",
        block_start_string="@%",
        block_end_string="%@",
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters |= {"comment": comment, "number": number, "numbers": numbers, "quoted": quoted, "xml": escape}
    made.filters["yaml"] = lambda names: yaml.safe_dump(
        list(names), default_flow_style=True, allow_unicode=True, width=math.inf
    ).strip()
    return made


def filled(folder: str, **values: Any) -> dict[str, str]:
    """Return the texts of all templates of a folder below exports/ by the path of their file, both with the values."""
    root, made = Path(__file__).parent / folder, _environment()
    files = {file.relative_to(root).with_suffix("").as_posix(): file for file in sorted(root.rglob("*.in"))}
    return {
        made.from_string(path).render(values): made.from_string(file.read_text(encoding="utf-8")).render(values)
        for path, file in files.items()
    }
