# SPDX-License-Identifier: Apache-2.0
"""Requirements, constraints and fingerprints: pure functions of text and files."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

LEVELS = {
    "run": ("run", "tables", "colcon"),
    "bench": ("run", "tables", "colcon", "bench"),
    "docs": ("run", "tables", "colcon", "docs"),
    "test": ("run", "tables", "colcon", "bench", "docs", "cluster", "plot", "test"),
}
"""Levels of the environment and the files in requirements/ they take."""
FILES_ONLY = "pages.txt"
"""The file in requirements/ whose distributions every level installs without their own dependencies."""


def normalise(name: str) -> str:
    """Return the canonical name of a distribution."""
    return re.sub(r"[-_.]+", "-", name).lower()


def entries(text: str) -> list[str]:
    """Return the lines of a requirements or constraints file without comments."""
    lines = (line.split("#", 1)[0].strip() for line in text.splitlines())
    return [line for line in lines if line]


def requirement_name(entry: str) -> str:
    """Return the name in an entry: `ros-jazzy-rclpy[fastrtps]>=7` -> `ros-jazzy-rclpy`."""
    found = re.match(r"[A-Za-z0-9][A-Za-z0-9._-]*", entry)
    if found is None:
        raise ValueError(f"not a requirement: {entry!r}")
    return normalise(found.group())


def pins(text: str) -> dict[str, str]:
    """Return name -> version of a constraints file."""
    pairs = (entry.split("==", 1) for entry in entries(text))
    return {requirement_name(name): version.split(";")[0].strip() for name, version in pairs}


def requirement_files(root: Path, level: str, wheels: bool) -> list[Path]:
    """Return the requirement files of a level, with ROS 2 and what goes with it if ROS 2 is installed from wheels."""
    ros = ("ros-wheels", *(f"ros-wheels-{each}" for each in ("bench", "test") if each in LEVELS[level]))
    names = (*LEVELS[level], *ros) if wheels else LEVELS[level]
    return [root / "requirements" / f"{name}.txt" for name in names]


def release(version: str) -> tuple[int, ...]:
    """Return the leading numbers of a version, for a coarse comparison."""
    found = re.match(r"\d+(\.\d+)*", version)
    return tuple(int(part) for part in found.group().split(".")) if found else ()


def relaxed(pinned: Mapping[str, str], installed: Mapping[str, str], exact: Collection[str] = ()) -> list[str]:
    """Return constraints next to an installed ROS 2: sufficient installed versions are kept, all others pinned.

    installed: versions of the ROS 2 installation and its system; exact: names that are always pinned.
    The message extensions of a ROS 2 installation are built against its NumPy: it is kept, or NumPy 1 taken.
    """
    lines = []
    for name, version in pinned.items():
        present = installed.get(name)
        if name == "numpy":
            lines.append(f"numpy=={present}" if present else "numpy<2")
        elif present and name not in exact:
            lines.append(f"{name}<={max(version, present, key=release)}")
        else:
            lines.append(f"{name}=={version}")
    return lines


def fingerprint(*parts: object) -> str:
    """Return a hash of texts and plain values."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def texts(paths: Iterable[Path]) -> dict[str, str]:
    """Return the contents of files by name; a missing file is empty."""
    return {path.name: path.read_text(encoding="utf-8") if path.exists() else "" for path in paths}


def read_stamp(path: Path) -> dict[str, Any]:
    """Return the stamp of an earlier, completed step; empty if there is none."""
    try:
        stamp = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return stamp if isinstance(stamp, dict) else {}


def write_stamp(path: Path, stamp: Mapping[str, object]) -> None:
    """Write a stamp atomically."""
    scratch = path.with_suffix(".part")
    scratch.write_text(json.dumps(stamp, indent=1), encoding="utf-8")
    scratch.replace(path)
