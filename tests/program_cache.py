# SPDX-License-Identifier: Apache-2.0
"""Compile C and C++ of the tests; what the compiler has read once, in this or an earlier run, is not compiled again."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from fjr_core.numerics.jit import processor, version
from isolation import CACHE
from time_limits import HANG

FOLDER = CACHE / "programs"
UNUSED = 7 * 86400.0  # s after which a program is removed


def built(command: Sequence[str], sources: Sequence[Path], program: Path, *options: str) -> Path:
    """Compile sources to a program, a library or an object file; fail on the first warning."""
    kept = FOLDER / _digest(command, sources, options)
    try:
        os.utime(kept)
    except FileNotFoundError:
        FOLDER.mkdir(exist_ok=True)
        made = kept.with_suffix(f".{os.getpid()}")
        libraries = [] if "-c" in (*command, *options) else ["-lm"]  # clang warns of a library that nothing links
        words = [*command, *options, *map(str, sources), "-o", str(made), *libraries]
        done = subprocess.run(words, capture_output=True, text=True, timeout=HANG)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
        os.replace(made, kept)
        for old in FOLDER.iterdir():
            if time.time() - old.stat().st_mtime > UNUSED:
                old.unlink(missing_ok=True)
    shutil.copy2(kept, program)
    return program


def _digest(command: Sequence[str], sources: Sequence[Path], options: Sequence[str]) -> str:
    """Return a digest of compiler, processor, options and sources with all that they include."""
    folders = [Path(option.removeprefix("-I")) for option in options if option.startswith("-I")]
    others = [option for option in options if not option.startswith("-I")]
    parts = [repr((command, version((command[0],)), processor(), others)).encode(), *_contents(sources, folders)]
    return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()[:32]


def _contents(sources: Sequence[Path], folders: Sequence[Path]) -> list[bytes]:
    """Return the contents of sources and of what they include from beside them or from `folders`, each once.

    The headers of the system are those of the compiler's version.
    """
    read: dict[Path, bytes] = {}
    waiting = [*sources]
    while waiting:
        file = waiting.pop().resolve()
        if file not in read:
            read[file] = file.read_bytes()
            names = re.findall(rb'^\s*#\s*include\s*["<]([^">\n]+)', read[file], re.MULTILINE)
            found = [folder / os.fsdecode(name) for name in names for folder in (file.parent, *folders)]
            waiting += [each for each in found if each.is_file()]
    return list(read.values())
