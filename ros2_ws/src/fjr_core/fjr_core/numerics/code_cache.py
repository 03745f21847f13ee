# SPDX-License-Identifier: Apache-2.0
"""Cache compiled code on disk in a folder that only this user can write; verify each file before it is loaded.

A shared object runs with the rights of the user who loads it. Code is therefore loaded only from a private folder, and
only if its SHA-256 digest equals the digest stored at compilation. No other user can change a file between this check
and the loading.
"""

from __future__ import annotations

import atexit
import fcntl
import hashlib
import logging
import os
import shutil
import stat
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

from ..files.text_file import DIGEST, whole_file

FOLDER_MODE, FILE_MODE = 0o700, 0o600  # the code is run by its owner only
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FILE = os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
_opened: dict[tuple[int, int], int] = {}
_log = logging.getLogger("fjr_core.numerics.jit")


def open_private(path: Path) -> Path:
    """Return a path of a folder, created if missing, through a descriptor that stays open, if the system supports it.

    Through it the folder stays the same, whoever exchanges its parents. Raises OSError, also for a folder that is a
    link, belongs to another user or can be written by others. There is one descriptor per folder, because the dynamic
    linker treats files of equal path as the same file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        path.mkdir(mode=FOLDER_MODE)
    if path.is_symlink():
        raise OSError(f"{path} is a symbolic link; expected a folder")
    descriptor = os.open(path, _FOLDER)
    status = os.fstat(descriptor)
    if not _is_ours(status):
        os.close(descriptor)
        found = f"belongs to user {status.st_uid}; expected a folder of user {os.geteuid()}"
        if status.st_uid == os.geteuid():
            found = f"has the mode {stat.S_IMODE(status.st_mode):03o}; expected that only its owner can write there"
        raise OSError(f"{path} {found}")
    known = _opened.setdefault((status.st_dev, status.st_ino), descriptor)
    if known != descriptor:
        os.close(descriptor)
    through = Path(f"/proc/self/fd/{known}")
    return through if through.is_dir() else path


def read(file: Path) -> bytes | None:
    """Return the content of a regular file that belongs to this user; None if there is no such file."""
    try:
        descriptor = os.open(file, os.O_RDONLY | _FILE)
    except (OSError, ValueError):
        return None
    with open(descriptor, "rb") as stream:
        status = os.fstat(descriptor)
        return stream.read() if _is_ours(status) and stat.S_ISREG(status.st_mode) else None


def write(file: Path, content: bytes) -> None:
    """Write a file and its digest atomically. Raises OSError."""
    with whole_file(file, sealed=True, mode=FILE_MODE) as scratch:
        scratch.write_bytes(content)


def _is_ours(status: os.stat_result) -> bool:
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def cache_folder() -> Path:
    """Return $XDG_CACHE_HOME/fjr, or ~/.cache/fjr; raise OSError if neither is defined."""
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:
        raise OSError("no home directory is known; expected HOME or XDG_CACHE_HOME to be set") from None
    return Path(base) / "fjr"


def code_folder() -> Path:
    """Open the cache folder, or a temporary folder if it is not private. Raises OSError."""
    try:
        return open_private(cache_folder())
    except OSError as error:
        return temporary_folder(str(error))


def temporary_folder(reason: str) -> Path:
    """Open a private folder that is removed when this process ends; log the reason once. Raises OSError.

    The folder becomes XDG_CACHE_HOME of this process and its child processes, so that they share it.
    """
    base = _temporary_base()
    if os.environ.get("XDG_CACHE_HOME") != base:
        _log.warning("%s; compiled code is kept in %s until this command ends", reason, base)
        os.environ["XDG_CACHE_HOME"] = base
    return open_private(cache_folder())


def is_intact(file: Path) -> bool:
    """Return whether a file exists with the content that was stored."""
    content, digest = read(file), read(file.with_name(file.name + DIGEST))
    return content is not None and digest == hashlib.sha256(content).hexdigest().encode()


def kept(name: str, make: Callable[[], bytes]) -> Path:
    """Return the intact file of this name; it is made where it is missing. Raises OSError.

    If two processes ask for the same file, one makes it and the other waits. Where the cache folder cannot be written,
    a temporary folder holds the file.
    """
    file = code_folder() / name
    try:
        return _ensured(file, make)
    except OSError as error:
        reason = f"cannot write to {cache_folder()} ({error.strerror or error})"
        return _ensured(temporary_folder(reason) / name, make)


def _ensured(file: Path, make: Callable[[], bytes]) -> Path:
    if is_intact(file):
        return file
    lock = os.open(file.with_name(f"{file.name}.lock"), os.O_RDWR | os.O_CREAT | _FILE, FILE_MODE)
    with open(lock, "r+b") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        if not is_intact(file):
            write(file, make())
    return file


@cache
def _temporary_base() -> str:
    base = tempfile.mkdtemp(prefix="fjr-cache-")
    atexit.register(_remove, base, os.getpid())
    return base


def _remove(base: str, creator: int) -> None:
    if os.getpid() == creator:  # not in a forked process
        shutil.rmtree(base, ignore_errors=True)
