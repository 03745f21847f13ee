# SPDX-License-Identifier: Apache-2.0
"""Cache compiled code on disk in a folder that only this user can write; verify each file before it is loaded.

A shared object runs with the rights of the user who loads it. Code is therefore loaded only from a PrivateFolder, and
only if its SHA-256 digest equals the digest stored at compilation. No other user can change a file between this check
and the loading.
"""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import shutil
import tempfile
from functools import cache
from pathlib import Path

from ..files.private_folder import NotPrivateError, PrivateFolder, open_private

_log = logging.getLogger("fjr_core.numerics.jit")


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
    except (NotPrivateError, OSError) as error:
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
    """True if the shared object exists with the content that was stored."""
    content, digest = folder.read(name), folder.read(f"{name}.sha256")
    return content is not None and digest == _digest(content)


def keep(folder: PrivateFolder, name: str, content: bytes) -> None:
    """Store a shared object and its digest. Raises OSError."""
    folder.write(name, content)
    folder.write(f"{name}.sha256", _digest(content))


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
