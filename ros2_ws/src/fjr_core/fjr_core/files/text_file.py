# SPDX-License-Identifier: Apache-2.0
"""Read text files and JSON objects of bounded size; write files atomically, with an optional checksum."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

LARGEST = 16 * 2**20  # bytes
_OPEN = os.O_RDONLY | os.O_CLOEXEC | getattr(os, "O_NONBLOCK", 0)  # a named pipe without a writer must not block
DIGEST = ".sha256"


def is_lines(value: str) -> bool:
    """Return True for the text of a table, False for a path."""
    return "\n" in value


def is_xml(value: str) -> bool:
    """Return True for XML text, False for a path."""
    return value.lstrip("\ufeff \t\r\n").startswith("<")


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Return the content of a regular file of at most LARGEST bytes.

    Raises OSError with the reason as `strerror`, also for an invalid path, a file that is not regular and a file that
    is too large.
    """
    try:
        descriptor = os.open(path, _OPEN)
    except ValueError as error:  # a NUL or half a surrogate pair in the path
        raise OSError(errno.EINVAL, str(error)) from None
    with open(descriptor, "rb") as stream:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "is not a regular file")
        content = stream.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise OSError(errno.EFBIG, f"is larger than {LARGEST // 2**20} MiB")
    return content


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the UTF-8 text of a file; a byte order mark is dropped. Raises OSError, UnicodeDecodeError."""
    return read_bytes(path).decode("utf-8-sig")


def read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file. Raises OSError, and ValueError for any other content."""
    try:
        found = json.loads(read_text(path))
    except RecursionError:
        raise ValueError("is nested too deeply") from None
    if not isinstance(found, dict):
        raise ValueError(f"holds a {type(found).__name__}; expected an object")
    return found


@contextmanager
def whole_file(path: Path, sealed: bool = False, mode: int = 0o666) -> Iterator[Path]:
    """Yield a path to write to; the file is renamed to `path` once its content is on disk.

    An exception in the block removes the partial file and keeps an earlier one; an OSError names the file. sealed:
    write the SHA-256 digest of the content to `<name>.sha256` before the rename. mode: permissions, less the umask.
    """
    scratch = path.with_name(f"{path.name}.{os.getpid()}.part")  # not that of another process
    try:
        scratch.touch(mode)
        yield scratch
        with scratch.open("rb") as written:
            os.fsync(written.fileno())
        if sealed:
            write_text(_seal(path), _digest(scratch), mode=mode)
        os.replace(scratch, path)
    except BaseException as error:
        if isinstance(error, OSError):  # that of a full disk names none
            error.filename = str(path)
        scratch.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str, sealed: bool = False, mode: int = 0o666) -> None:
    """Write a text file atomically; sealed, mode: see whole_file."""
    with whole_file(path, sealed, mode) as scratch:
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
