# SPDX-License-Identifier: Apache-2.0
"""The virtual environment with the pinned packages, made unless a stamp shows that it is complete."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from envsetup.commands import clean_environment, run
from envsetup.machine import base_interpreter, venv_module

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


OUTSIDE = """
import importlib.metadata, json, sys
found = [each for each in importlib.metadata.distributions() if each.metadata["Name"]]
outside = [each for each in found if not str(each.locate_file("")).startswith(sys.prefix)]
print(json.dumps({each.metadata["Name"]: each.version for each in reversed(outside)}))
"""
"""Prints name and version of the distributions that the environment's Python sees outside the environment."""


class Environment:
    """`.venv` (ROS 2 from wheels) or `.venv-ros` (with a sourced ROS 2) in the root of the checkout."""

    def __init__(self, root: Path, sourced_ros: bool) -> None:
        self.root = root
        self.sourced_ros = sourced_ros
        self.path = root / (".venv-ros" if sourced_ros else ".venv")
        self.python = self.path / "bin" / "python"
        self.env = clean_environment(sourced_ros)
        self.log = root / ".setup" / "environment.log"
        self._stamp = self.path / ".complete.json"

    def ensure(self, level: str) -> None:
        """Install the packages of a level (see LEVELS) unless they are complete."""
        wanted, stamp = self.wanted(level), read_stamp(self._stamp)
        usable = stamp.get("identity") == self.identity() and self.python.exists()
        if usable and wanted.items() <= stamp.get("installed", {}).items():
            return
        self.log.unlink(missing_ok=True)
        if not usable:
            self._create()
        self._stamp.unlink(missing_ok=True)
        self._install(level)
        write_stamp(self._stamp, {"identity": self.identity(), "installed": wanted})

    def add_compiler(self) -> None:
        """Install the C compiler that comes as a wheel."""
        file = self.root / "requirements" / "compiler.txt"
        self._pip("C compiler ziglang", self._constraints(), f"--requirement={file}")

    def identity(self) -> list[str]:
        """Return the properties that require a new environment when they change."""
        ros = self.env.get("AMENT_PREFIX_PATH", "") if self.sourced_ros else ""
        return [str(self.path), base_interpreter(), sys.version, ros.split(os.pathsep)[-1]]

    def wanted(self, level: str) -> dict[str, str]:
        """Return the fingerprints of the requirement files of a level, with all else that its packages depend on."""
        others = texts([self._files_only(), self.root / "constraints.txt", Path(__file__)])
        files = requirement_files(self.root, level, not self.sourced_ros)
        return {file.name: fingerprint(texts([file]), others) for file in files}

    def _create(self) -> None:
        venv_module().ensure(self.log, self.env)
        if self.path.exists():
            shutil.rmtree(self.path)
        options = ["--system-site-packages"] if self.sourced_ros else []
        title = f"virtual environment {self.path.name} for Python {sys.version.split()[0]}"
        command = [base_interpreter(), "-m", "venv", *options, str(self.path)]
        run(title, command, self.log, self.env, f"{self.path} could not be made")

    def _install(self, level: str) -> None:
        constraints = self._constraints()
        files = requirement_files(self.root, level, not self.sourced_ros)
        extent = "what ROS 2 does not bring" if self.sourced_ros else "with ROS 2, 290 to 350 MB the first time"
        packages = [f"--requirement={file}" for file in files]
        self._pip("installer (pip, setuptools)", constraints, "pip", "setuptools")
        self._pip(f"packages to {level} ({extent})", constraints, *packages)
        self._pip("files of the pages", constraints, "--no-deps", f"--requirement={self._files_only()}")
        share_equal_files(self.path)

    def _files_only(self) -> Path:
        return self.root / "requirements" / FILES_ONLY

    def _pip(self, title: str, constraints: Path, *wanted: str) -> None:
        """Install by pip; only empy is built, with the pinned setuptools of the environment itself."""
        options = ["--progress-bar=off", "--no-build-isolation", "--only-binary=:all:", "--no-binary=empy"]
        command = [str(self.python), "-m", "pip", "install", *options, f"--constraint={constraints}", *wanted]
        run(title, command, self.log, self.env, "pip could not install the pinned packages")

    def _constraints(self) -> Path:
        """Return constraints.txt, relaxed next to a sourced ROS 2 to keep its versions."""
        pinned = self.root / "constraints.txt"
        if not self.sourced_ros:
            return pinned
        listing = subprocess.check_output([str(self.python), "-c", OUTSIDE], env=self.env, text=True)
        installed = {normalise(name): version for name, version in json.loads(listing).items()}
        tools = entries((self.root / "requirements" / "test.txt").read_text(encoding="utf-8"))
        exact = {requirement_name(entry) for entry in tools}
        lines = relaxed(pins(pinned.read_text(encoding="utf-8")), installed, exact)
        target = self.path / "constraints.txt"
        target.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return target


def share_equal_files(folder: Path, least: int = 1 << 16) -> None:
    """Make equal files of at least `least` bytes one file with several names.

    Wheels cannot hold symbolic links, so that libraries of CasADi and ROS 2 come two to seven times.
    """
    first: dict[tuple[int, bytes], Path] = {}
    for file in sorted(folder.rglob("*")):
        status = file.lstat()
        if not stat.S_ISREG(status.st_mode) or status.st_size < least:
            continue
        other = first.setdefault((status.st_mode, hashlib.sha256(file.read_bytes()).digest()), file)
        if not other.samefile(file):
            scratch = file.with_name(f"{file.name}.link")
            scratch.unlink(missing_ok=True)
            with suppress(OSError):  # a file system without links, or a file with as many as it has: they stay two
                os.link(other, scratch)
                scratch.replace(file)
