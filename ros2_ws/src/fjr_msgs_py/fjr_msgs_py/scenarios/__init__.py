# SPDX-License-Identifier: Apache-2.0
"""Installed scenarios, sweeps and suites, and parameter changes from the command line. Imports nothing slow."""

from __future__ import annotations

from pathlib import Path

from fjr_core.errors import MissingPackageError
from fjr_msgs_py.console.ros2 import INSTALLATION, installed_files


def installed(kind: str) -> dict[str, Path]:
    """Return the installed files of a kind (scenarios, sweeps, suites) by name; raises MissingPackageError."""
    found = installed_files(kind)
    if not found:
        raise MissingPackageError(f"package fjr_bringup is not installed here; {INSTALLATION}")
    return found


def summary(path: Path) -> str:
    """Return the first sentence of the first comment of a scenario file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    comments = [line.lstrip("# ") for line in lines if line.startswith("#") and "SPDX" not in line]
    return comments[0].partition(". ")[0] if comments else ""
