# SPDX-License-Identifier: Apache-2.0
"""Write files atomically, with an optional checksum that detects later changes."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DIGEST = ".sha256"


@contextmanager
def whole_file(path: Path, sealed: bool = False) -> Iterator[Path]:
    """Yield a path to write to; the file is renamed to `path` once its content is on disk.

    An exception in the block removes the partial file and keeps an earlier one. sealed: write the SHA-256 digest of
    the content to `<name>.sha256` before the rename.
    """
    scratch = path.with_name(f"{path.name}.part")
    try:
        yield scratch
        with scratch.open("rb") as written:
            os.fsync(written.fileno())
        if sealed:
            write_text(_seal(path), _digest(scratch))
        os.replace(scratch, path)
    except BaseException:
        scratch.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str, sealed: bool = False) -> None:
    """Write a text file atomically; sealed: see whole_file."""
    with whole_file(path, sealed) as scratch:
        scratch.write_text(text, encoding="utf-8")


def is_sealed(path: Path) -> bool:
    """Return whether a file exists and matches its SHA-256 digest."""
    try:
        return _seal(path).read_text(encoding="ascii") == _digest(path)
    except (OSError, UnicodeDecodeError):
        return False


def _seal(path: Path) -> Path:
    return path.with_name(path.name + DIGEST)


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(2**20):
            digest.update(block)
    return digest.hexdigest()
