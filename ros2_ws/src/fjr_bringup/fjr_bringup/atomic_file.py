# SPDX-License-Identifier: Apache-2.0
"""Write files that are there whole or not at all, and tell later whether their content is still what was written."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DIGEST = ".sha256"


@contextmanager
def whole_file(path: Path, sealed: bool = False) -> Iterator[Path]:
    """Yield a path to write to; the file takes the name `path` once it is written and on disk.

    An exception in the block removes what was written and leaves an earlier file as it is. sealed: note the SHA-256
    digest of the content in `<name>.sha256` next to it, before the file takes its name.
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
    """Write a text file that is there whole or not at all."""
    with whole_file(path, sealed) as scratch:
        scratch.write_text(text, encoding="utf-8")


def is_sealed(path: Path) -> bool:
    """Whether a file is there with the content that it was written with."""
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
