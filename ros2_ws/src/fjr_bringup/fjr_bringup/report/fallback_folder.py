# SPDX-License-Identifier: Apache-2.0
"""Write a report into a temporary folder, and report that on stderr, if its own folder cannot be written."""

from __future__ import annotations

import errno
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

UNWRITABLE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.ENOTDIR)


def write_with_fallback(folder: Path, write: Callable[[Path], object]) -> Path:
    """Create the folder and call `write` with it, or with a new temporary folder if the first cannot be written.

    Return the folder that was written. Raises OSError if neither can be.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write(folder)
        return folder
    except OSError as error:
        if error.errno not in UNWRITABLE:
            raise
        other = Path(tempfile.mkdtemp(prefix=f"fjr-{folder.name}-"))
        print(f"fjr: cannot write to {folder} ({error.strerror}); the report is in {other}", file=sys.stderr)
    write(other)
    return other
