# SPDX-License-Identifier: Apache-2.0
"""Cache compiled code on disk in a folder that only this user can write; verify each file before it is loaded.

A shared object runs with the rights of the user who loads it. Code is therefore loaded only from a PrivateFolder, and
only if its SHA-256 digest equals the digest stored at compilation. No other user can change a file between this check
and the loading.
"""

from __future__ import annotations

import atexit
import fcntl
import hashlib
import logging
import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

MODE = 0o700  # of the folder: its code is run by its owner only
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FILE = os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
_opened: dict[tuple[int, int], int] = {}
_log = logging.getLogger("fjr_core.numerics.jit")


@dataclass(frozen=True)
class PrivateFolder:
    """An open folder, created by `open_private`. path: its name in messages."""

    path: Path
    descriptor: int

    def read(self, name: str) -> bytes | None:
        """Return the content of a file that belongs to this user; None if there is no such file."""
        try:
            descriptor = os.open(name, os.O_RDONLY | _FILE, dir_fd=self.descriptor)
        except (OSError, ValueError):
            return None
        with open(descriptor, "rb") as stream:
            status = os.fstat(descriptor)
            return stream.read() if _is_ours(status) and stat.S_ISREG(status.st_mode) else None

    def write(self, name: str, content: bytes) -> None:
        """Write a file atomically. Raises OSError."""
        scratch = f".{name}.{secrets.token_hex(8)}"
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | _FILE
        try:
            with open(os.open(scratch, flags, 0o600, dir_fd=self.descriptor), "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(scratch, name, src_dir_fd=self.descriptor, dst_dir_fd=self.descriptor)
        except BaseException:
            with suppress(OSError):
                os.unlink(scratch, dir_fd=self.descriptor)
            raise

    @contextmanager
    def locked(self, name: str) -> Iterator[None]:
        """Hold a lock among the processes of this user. Raises OSError."""
        flags = os.O_RDWR | os.O_CREAT | _FILE
        with open(os.open(name, flags, 0o600, dir_fd=self.descriptor), "r+b") as held:
            fcntl.flock(held, fcntl.LOCK_EX)
            yield

    def within(self, name: str) -> str:
        """Return a path for the dynamic linker, through the open descriptor if the system supports it."""
        through = f"/proc/self/fd/{self.descriptor}"
        return f"{through if os.path.isdir(through) else self.path}/{name}"


def open_private(path: Path) -> PrivateFolder:
    """Open a folder, created if missing.

    Raises OSError, also for a folder that is a link, belongs to another user or can be written by others. One
    descriptor per folder stays open, because the dynamic linker treats files of equal path as the same file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        path.mkdir(mode=MODE)
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
    return PrivateFolder(path, known)


def _is_ours(status: os.stat_result) -> bool:
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def cache_folder() -> Path:
    """Return $XDG_CACHE_HOME/fjr, or ~/.cache/fjr; raise OSError if neither is defined."""
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:
        raise OSError("no home directory is known; expected HOME or XDG_CACHE_HOME to be set") from None
    return Path(base) / "fjr"


def code_folder() -> PrivateFolder:
    """Open the cache folder, or a temporary folder if it is not private. Raises OSError."""
    try:
        return open_private(cache_folder())
    except OSError as error:
        return temporary_folder(str(error))


def temporary_folder(reason: str) -> PrivateFolder:
    """Open a private folder that is removed when this process ends; log the reason once. Raises OSError.

    The folder becomes XDG_CACHE_HOME of this process and its child processes, so that they share it.
    """
    base = _temporary_base()
    if os.environ.get("XDG_CACHE_HOME") != base:
        _log.warning("%s; compiled code is kept in %s until this command ends", reason, base)
        os.environ["XDG_CACHE_HOME"] = base
    return open_private(Path(base) / "fjr")


def is_intact(folder: PrivateFolder, name: str) -> bool:
    """Return whether a file exists with the content that was stored."""
    content, digest = folder.read(name), folder.read(f"{name}.sha256")
    return content is not None and digest == _digest(content)


def kept(name: str, make: Callable[[], bytes]) -> PrivateFolder:
    """Return the folder that holds an intact file of this name; the file is made where it is missing. Raises OSError.

    If two processes ask for the same file, one makes it and the other waits. Where the cache folder cannot be written,
    a temporary folder holds the file.
    """
    folder = code_folder()
    try:
        return _ensured(folder, name, make)
    except OSError as error:
        reason = f"cannot write to {folder.path} ({error.strerror or error})"
        return _ensured(temporary_folder(reason), name, make)


def _ensured(folder: PrivateFolder, name: str, make: Callable[[], bytes]) -> PrivateFolder:
    if not is_intact(folder, name):
        with folder.locked(f"{name}.lock"):
            if not is_intact(folder, name):
                content = make()
                folder.write(name, content)
                folder.write(f"{name}.sha256", _digest(content))
    return folder


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


@cache
def _temporary_base() -> str:
    base = tempfile.mkdtemp(prefix="fjr-cache-")
    atexit.register(_remove, base, os.getpid())
    return base


def _remove(base: str, creator: int) -> None:
    if os.getpid() == creator:  # not in a forked process
        shutil.rmtree(base, ignore_errors=True)
