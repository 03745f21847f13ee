# SPDX-License-Identifier: Apache-2.0
"""Folders of the runs of a scenario: NAME-001, NAME-002, ..., and the link NAME to the newest."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

from fjr_core.errors import FjrError
from fjr_msgs_py.console.output import tell


class FolderError(FjrError):
    """A folder that cannot be written or must not be replaced."""


def is_run(folder: Path) -> bool:
    """Return whether a folder holds an earlier run."""
    return (folder / "report.json").is_file() or any((folder / "bag").glob("*.mcap"))


class RunFolder:
    """Context manager that creates a new, empty folder `path`; earlier runs are not replaced.

    link: the name without a number; `keep` points it to the new folder. Without `keep` the folder is removed at
    the end of the block.
    """

    def __init__(self, link: Path) -> None:
        self.link = self.path = link
        self._kept = False

    def __enter__(self) -> RunFolder:
        link = self.link
        if link.exists() and not (link.is_dir() and (is_run(link) or not any(link.iterdir()))):
            raise FolderError(f"{link} exists and is not an earlier run (no report.json, no bag): not replaced")
        try:
            link.parent.mkdir(parents=True, exist_ok=True)
            if link.is_dir() and not link.is_symlink():
                if any(link.iterdir()):  # an earlier run without a number
                    numbered = _new_folder(link)
                    link.rename(numbered)  # replaces the empty folder
                    _point(link, numbered.name)
                else:
                    link.rmdir()
            self.path = _new_folder(link)
        except OSError as error:
            raise FolderError(f"cannot write to {link}: {error.strerror}") from None
        return self

    def keep(self) -> None:
        """Keep this run and point the link to it."""
        self._kept = True
        try:
            _point(self.link, self.path.name)
        except OSError as error:
            tell(f"no link {self.link} to {self.path.name}: {error.strerror}")

    def __exit__(self, *_: object) -> None:
        if not self._kept:
            shutil.rmtree(self.path, ignore_errors=True)


def _new_folder(link: Path) -> Path:
    """Create the folder with the next free number."""
    numbers = [re.fullmatch(re.escape(link.name) + r"-(\d{3,})", entry.name) for entry in link.parent.iterdir()]
    number = 1 + max((int(found[1]) for found in numbers if found), default=0)
    while True:
        folder = link.with_name(f"{link.name}-{number:03}")
        try:
            folder.mkdir()
        except FileExistsError:  # another run has just taken it
            number += 1
        else:
            return folder


def _point(link: Path, target: str) -> None:
    """Create or move a link atomically."""
    fresh = link.with_name(f".{link.name}.{os.getpid()}")
    fresh.unlink(missing_ok=True)
    fresh.symlink_to(target, target_is_directory=True)
    fresh.replace(link)
