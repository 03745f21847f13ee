# SPDX-License-Identifier: Apache-2.0
"""Paths of meshes in a URDF text that leaves its folder."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

_FILE_NAME = re.compile(r"(<mesh\b[^>]*?\bfilename\s*=\s*)([\"'])(.*?)\2", re.DOTALL)
_PACKAGE, _URI = "package://", "file://"


def located(urdf: str, folder: Path) -> str:
    """Return the URDF text with file:// paths of the meshes that exist in `folder`, where its file is, or above it.

    A relative path starts at the folder. ``package://name/path`` is replaced if the folder or one above it is called
    `name`, or contains a folder of that name, and has the path in it. All other text stays as it is.
    """

    def replaced(match: re.Match[str]) -> str:
        path = next((path for path in _candidates(match[3], folder.absolute()) if path.is_file()), None)
        return match[0] if path is None else f"{match[1]}{match[2]}{_URI}{path}{match[2]}"

    return _FILE_NAME.sub(replaced, urdf)


def _candidates(name: str, folder: Path) -> Iterator[Path]:
    if not name.startswith(_PACKAGE):
        if not name.startswith(_URI) and not Path(name).is_absolute():
            yield folder / name
        return
    package, _, path = name[len(_PACKAGE) :].partition("/")
    for above in (folder, *folder.parents):
        if above.name == package:
            yield above / path
        yield above / package / path
