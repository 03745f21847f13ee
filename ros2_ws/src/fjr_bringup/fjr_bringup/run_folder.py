# SPDX-License-Identifier: Apache-2.0
"""The folder of a run. An earlier run is replaced; anything else is left alone."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from fjr_core.errors import FjrError


class FolderError(FjrError):
    """A place where no run can be written."""


def is_run(folder: Path) -> bool:
    """Whether a folder was made by an earlier run."""
    return (folder / "report.json").is_file() or any((folder / "bag").glob("*.mcap"))


class RunFolder:
    """A new, empty folder as a context manager.

    An earlier run of the same name steps aside and comes back when the block ends without `keep`, so a run
    that could not start costs nothing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._previous = path.with_name(f".{path.name}.previous-{os.getpid()}")
        self._kept = False

    def keep(self) -> None:
        """This run is worth more than the previous one."""
        self._kept = True

    def __enter__(self) -> RunFolder:
        path = self.path
        if path.exists() and not (path.is_dir() and (is_run(path) or not any(path.iterdir()))):
            raise FolderError(f"{path} exists and is not an earlier run (no report.json, no bag): not replaced")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.exists():
                path.rename(self._previous)
            path.mkdir()
        except OSError as error:
            raise FolderError(f"cannot write to {path}: {error.strerror}") from None
        return self

    def __exit__(self, *_: object) -> None:
        if not self._kept:
            shutil.rmtree(self.path, ignore_errors=True)
            if self._previous.exists():
                self._previous.rename(self.path)
        shutil.rmtree(self._previous, ignore_errors=True)
