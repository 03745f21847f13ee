# SPDX-License-Identifier: Apache-2.0
"""Folder of a study that is resumed: used by one process at a time, with a description of the study that it holds."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fjr_core.errors import FjrError
from fjr_core.files.text_file import read_json, write_text


class StoreError(FjrError):
    """A folder that holds another study or is in use."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock an existing folder for this process; raise StoreError if another one uses it."""
    with (folder / ".lock").open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(f"{folder} is in use by another process; expected one at a time") from None
        yield


def check_description(path: Path, wanted: Mapping[str, Any], program: str, runs: bool, command: str) -> None:
    """Write the description of a study, or check that the file describes this study; raise StoreError.

    program: hash of the code that computes the results. runs: the folder holds results. command: that writes them.
    """
    try:
        found = read_json(path)
    except FileNotFoundError:
        if runs:
            raise StoreError(
                f"{path.parent} holds runs without their {path.name}; expected both, or another --output"
            ) from None
        write_text(path, json.dumps({**wanted, "program": program}, indent=1))
        return
    except ValueError:
        raise StoreError(f"{path} cannot be read; expected the file that `{command}` wrote") from None
    different = [name for name in wanted if found.get(name) != wanted[name]]
    if different:
        differences = ", ".join(_difference(name, found.get(name), wanted[name]) for name in different)
        raise StoreError(
            f"{path.parent} holds another study ({differences}); expected the same one, or another --output"
        )
    if found.get("program") != program:
        raise StoreError(
            f"{path.parent} was started by another version of this program (source, CasADi, C compiler); "
            "expected the same version, or another --output"
        )


def _difference(name: str, there: object, here: object) -> str:
    if isinstance(there, (int, float)) and isinstance(here, (int, float)):
        return f"{name} is {there:g}, not {here:g}"
    if isinstance(there, dict) and isinstance(here, dict):
        return f"{name} differs in {', '.join(sorted(k for k in {*there, *here} if there.get(k) != here.get(k)))}"
    return f"{name} differs"
