# SPDX-License-Identifier: Apache-2.0
"""Make colcon's scripts usable from a checkout whose path has spaces.

colcon writes the path unquoted in setup.sh, and the path of Python in local_setup.*. setuptools writes the latter into
the first line of the nodes, which the kernel splits at the first space.
"""

from __future__ import annotations

import re
from pathlib import Path

PREFIX = re.compile(r"^(_colcon\w*_COLCON_CURRENT_PREFIX=)(/.*)$", re.MULTILINE)
CALL = re.compile(r"\$\(\$_colcon_python_executable ")
FIRST_LINE = re.compile(rb'^#!\s*"?(?P<python>/[^"\n]* [^"\n]*?)"?(?: -x)?\n')


def quote_paths(install: Path) -> None:
    """Quote the paths in the scripts of an install folder."""
    for script in [path for form in ("*.sh", "*.bash", "*.zsh") for path in install.rglob(form)]:
        text = script.read_text(encoding="utf-8")
        quoted = CALL.sub('$("$_colcon_python_executable" ', PREFIX.sub(_quoted, text))
        if quoted != text:
            script.write_text(quoted, encoding="utf-8")
    for executable in _executables(install):
        content = executable.read_bytes()
        started = FIRST_LINE.sub(_by_the_shell, content)
        if started != content:
            executable.write_bytes(started)


def _executables(install: Path) -> list[Path]:
    """Return the executables in <package>/lib/<package>."""
    found = install.glob("*/lib/*/*")
    return [path for path in found if path.is_file() and path.parent.name == path.parents[2].name]


def _quoted(line: re.Match[str]) -> str:
    path = line[2].strip('"').replace("'", "'\\''")
    return f"{line[1]}'{path}'"


def _by_the_shell(line: re.Match[bytes]) -> bytes:
    """Return two lines that sh executes as `exec python` and Python ignores as a string."""
    return b"#!/bin/sh\n'''exec' \"" + line["python"] + b'" "$0" "$@"\n\' \'\'\'\n'
