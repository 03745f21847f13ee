# SPDX-License-Identifier: Apache-2.0
"""Create the virtual environment with the pinned packages unless a stamp shows it is complete."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

from envsetup import pins
from envsetup.commands import clean_environment, run
from envsetup.machine import base_interpreter, venv_module

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
        """Install the packages of a level (see pins.LEVELS) unless they are complete."""
        wanted, stamp = self.wanted(level), pins.read_stamp(self._stamp)
        usable = stamp.get("identity") == self.identity() and self.python.exists()
        if usable and wanted.items() <= stamp.get("installed", {}).items():
            return
        self.log.unlink(missing_ok=True)
        if not usable:
            self._create()
        self._stamp.unlink(missing_ok=True)
        self._install(level)
        pins.write_stamp(self._stamp, {"identity": self.identity(), "installed": wanted})

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
        others = pins.texts([self._files_only(), self.root / "constraints.txt", Path(__file__), Path(pins.__file__)])
        files = pins.requirement_files(self.root, level, not self.sourced_ros)
        return {file.name: pins.fingerprint(pins.texts([file]), others) for file in files}

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
        files = pins.requirement_files(self.root, level, not self.sourced_ros)
        extent = "what ROS 2 does not bring" if self.sourced_ros else "with ROS 2, 290 to 350 MB the first time"
        packages = [f"--requirement={file}" for file in files]
        self._pip("installer (pip, setuptools)", constraints, "pip", "setuptools")
        self._pip(f"packages to {level} ({extent})", constraints, *packages)
        self._pip("files of the pages", constraints, "--no-deps", f"--requirement={self._files_only()}")
        share_equal_files(self.path)

    def _files_only(self) -> Path:
        return self.root / "requirements" / pins.FILES_ONLY

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
        installed = {pins.normalise(name): version for name, version in json.loads(listing).items()}
        tools = pins.entries((self.root / "requirements" / "test.txt").read_text(encoding="utf-8"))
        exact = {pins.requirement_name(entry) for entry in tools}
        lines = pins.relaxed(pins.pins(pinned.read_text(encoding="utf-8")), installed, exact)
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
            file.unlink()
            os.link(other, file)
