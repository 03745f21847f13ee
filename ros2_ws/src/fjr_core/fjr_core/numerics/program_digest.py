# SPDX-License-Identifier: Apache-2.0
"""What else than their input results that are kept depend on: this package's source, CasADi, a compiler."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import casadi as ca

SOURCES = ("*.py", "*.c")


def program_digest(compiled: bool) -> str:
    """Tells apart programs whose numbers may differ; compiled: whether the loop is machine code."""
    return hashlib.sha256(f"{source_digest()} {ca.__version__} {compiled}".encode()).hexdigest()


@cache
def source_digest(folder: Path = Path(__file__).parents[1]) -> str:
    """Of all Python and C in a folder, by default this package's, with the names of the files."""
    digest = hashlib.sha256()
    for path in sorted(path for pattern in SOURCES for path in folder.rglob(pattern)):
        digest.update(f"{path.relative_to(folder)} {path.stat().st_size}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()
