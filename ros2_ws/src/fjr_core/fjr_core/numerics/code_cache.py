# SPDX-License-Identifier: Apache-2.0
"""Compiled code between processes: in a folder that only this user can write, each file verified before it is loaded.

Whoever writes a shared object that this process loads runs code as this user. So code is taken only from a
PrivateFolder, and only where the SHA-256 digest that was noted when it was compiled is the digest of the content. The
folder being private, nothing can change between that check and the loading.
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
    """Return $XDG_CACHE_HOME/fjr, or ~/.cache/fjr; raises OSError where neither is known."""
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:
        raise OSError("no home directory is known; expected HOME or XDG_CACHE_HOME to be set") from None
    return Path(base) / "fjr"


def code_folder() -> PrivateFolder:
    """Open the cache folder; a temporary one, said once, where that is not private. Raises OSError."""
    try:
        return open_private(cache_folder())
    except (NotPrivateError, OSError) as error:
        return temporary_folder(str(error))


def temporary_folder(reason: str) -> PrivateFolder:
    """Open a private folder that is removed when this process ends, and say why once. Raises OSError.

    It becomes XDG_CACHE_HOME of this process and of those that it starts, so that they share it.
    """
    base = _temporary_base()
    if os.environ.get("XDG_CACHE_HOME") != base:
        _log.warning("%s; compiled code is kept in %s until this command ends", reason, base)
        os.environ["XDG_CACHE_HOME"] = base
    return open_private(Path(base) / "fjr")


def is_whole(folder: PrivateFolder, name: str) -> bool:
    """Whether a shared object is there with the content that it was kept with."""
    content, digest = folder.read(name), folder.read(f"{name}.sha256")
    return content is not None and digest == _digest(content)


def keep(folder: PrivateFolder, name: str, content: bytes) -> None:
    """Keep a shared object and its digest. Raises OSError."""
    folder.write(name, content)
    folder.write(f"{name}.sha256", _digest(content))


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


@cache
def _temporary_base() -> str:
    base = tempfile.mkdtemp(prefix="fjr-cache-")
    atexit.register(_remove, base, os.getpid())
    return base


def _remove(base: str, maker: int) -> None:
    if os.getpid() == maker:  # not a fork of it
        shutil.rmtree(base, ignore_errors=True)
