# SPDX-License-Identifier: Apache-2.0
"""C text: CasADi's functions under a prefix, arrays of numbers, names."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError

LONGEST_PREFIX = 40
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
"""What <prefix>.h, <prefix>.c or the target <prefix> would stand in the way of, in small letters."""
ON_A_LINE = 6

_QUIET = """\
/* Made by CasADi {version}, https://web.casadi.org. All functions have one signature: some arguments are unused. */
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
"""


def prefix_of(name: str) -> str:
    """A name as the beginning of C identifiers: paper_k31 of paper_k31, arm_7_b of "arm-7 b"."""
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")[:LONGEST_PREFIX]
    if plain[:1].isalpha() and plain.lower() not in RESERVED:
        return plain
    return f"loop_{plain}"[:LONGEST_PREFIX].rstrip("_")


def checked_prefix(prefix: str) -> str:
    """The prefix, if C identifiers can begin with it and its files are in nothing's way; raises ParameterError."""
    if not re.fullmatch(rf"[A-Za-z][A-Za-z0-9_]{{0,{LONGEST_PREFIX - 1}}}", prefix):
        raise ParameterError(
            f"prefix is '{prefix}'; expected a letter, then letters, digits or '_', at most {LONGEST_PREFIX}"
        )
    if prefix.lower() in RESERVED:
        raise ParameterError(
            f"prefix is '{prefix}', which a header of C, CMake or the export itself is called; expected another one"
        )
    return prefix


def casadi_code(prefix: str, functions: Mapping[str, ca.Function]) -> str:
    """One C file with the functions as <prefix>_casadi_<name>; constants with 17 digits, no memory of its own."""
    generator = ca.CodeGenerator(f"{prefix}_casadi", {"include_math": True, "indent": 2})
    for name, function in functions.items():
        generator.add(renamed(function, f"{prefix}_casadi_{name}"))
    code = str(generator.dump())
    if "#error" in code:
        raise ParameterError(f"CasADi cannot write one of {', '.join(functions)} as C; expected functions that it can")
    return _QUIET.format(version=ca.__version__) + code


def renamed(function: ca.Function, name: str) -> ca.Function:
    """The same function under another name."""
    arguments = [ca.MX.sym(key, *function.size_in(i)) for i, key in enumerate(function.name_in())]
    return ca.Function(name, arguments, function.call(arguments), function.name_in(), function.name_out())


def work_sizes(prefix: str, functions: Mapping[str, ca.Function]) -> dict[str, int]:
    """Sizes arg, res, iw, w, each 1 or more, of working memory for any of the functions as casadi_code writes them."""
    all_ = [renamed(function, f"{prefix}_casadi_{name}") for name, function in functions.items()]
    return {size: max(1, *(getattr(f, f"sz_{size}")() for f in all_)) for size in ("arg", "res", "iw", "w")}


def numbers(values: ArrayLike) -> str:
    """The entries of an array of doubles, exactly; one 0.0 for none, for C has no empty arrays."""
    flat = [number(value) for value in np.ravel(values).astype(float).tolist()] or ["0.0"]
    lines = [", ".join(flat[i : i + ON_A_LINE]) for i in range(0, len(flat), ON_A_LINE)]
    return ",\n    ".join(lines)


def number(value: float) -> str:
    """A double of math.h's C, the very same."""
    return repr(value) if math.isfinite(value) else "NAN" if math.isnan(value) else f"{'-' * (value < 0)}INFINITY"


def strings(values: Sequence[str]) -> str:
    """The entries of an array of strings."""
    return ", ".join(quoted(value) for value in values)


def quoted(text: str) -> str:
    """A string literal; what is not plain ASCII is escaped byte by byte, in octal."""
    plain = [chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in text.encode()]
    return f'"{"".join(plain)}"'


def comment(text: str) -> str:
    """A text that a line of a C comment may hold."""
    return " ".join(text.split()).replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")
