# SPDX-License-Identifier: Apache-2.0
"""Build a wheel of each package in ros2_ws/src, and the wheel `fjr` with all of them: `build_wheels.py [FOLDER]`.

`fjr` requires ROS 2 Jazzy's wheels at the versions of constraints.txt, everything else from its lower bound on.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from envsetup.commands import PREFIX, SetupError, clean_environment, run
from envsetup.environment import FILES_ONLY, entries, pins, requirement_name

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = tuple(sorted(file.parent.name for file in ROOT.glob("ros2_ws/src/*/setup.py")))
COPIED = ("README.md", "LICENSE", "pyproject.toml", "requirements", "ros2_ws/src")
"""What the wheels are made of; they are built in a copy, so that no file of an earlier build enters."""
UPLOT, UPLOT_FILES = "uplot-python", ("uPlot.iife.js", "uPlot.min.css")
TEMPLATES = "ros2_ws/src/fjr_monitor/fjr_monitor/report/templates"
LOG = ROOT / ".setup" / "wheels.log"
BUILD = """
import os, sys
from setuptools.build_meta import __legacy__
target, *folders = sys.argv[1:]
for folder in folders:
    os.chdir(folder)
    __legacy__.build_wheel(target)
"""
"""What pip runs for a folder, for all folders in one process: pip would start three for each."""


def build(target: Path) -> list[Path]:
    """Build all wheels into a folder, which loses its old wheels; return their paths."""
    target.mkdir(parents=True, exist_ok=True)
    for old in target.glob("fjr*.whl"):
        old.unlink()
    with tempfile.TemporaryDirectory(prefix="fjr-wheels-") as scratch:
        source = Path(scratch)
        copy_sources(source)
        pin_ros(source / "requirements" / "ros-wheels.txt")
        bring_uplot(source)
        folders = [str(source), *(str(source / "ros2_ws" / "src" / name) for name in PACKAGES)]
        command = [sys.executable, "-c", BUILD, str(target.resolve()), *folders]
        run("wheels", command, LOG, clean_environment(sourced_ros=False), "setuptools could not build the wheels")
    return sorted(target.glob("fjr*.whl"))


def copy_sources(target: Path) -> None:
    """Copy COPIED without the outputs of earlier builds."""
    without = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, target / name, ignore=without)
        else:
            shutil.copy(ROOT / name, target / name)


def pin_ros(requirements: Path) -> None:
    """Rewrite a requirements file with the pinned versions of the distributions of ROS 2."""
    pinned = pins((ROOT / "constraints.txt").read_text(encoding="utf-8"))
    given = {entry: requirement_name(entry) for entry in entries(requirements.read_text(encoding="utf-8"))}
    lines = [f"{entry}=={pinned[name]}" if name.startswith("ros-") else entry for entry, name in given.items()]
    requirements.write_text("\n".join(lines) + "\n", encoding="utf-8")


def bring_uplot(source: Path) -> None:
    """Copy uPlot (MIT) beside the templates of the pages, and require it no more: its wheel requires IPython, 65 MB."""
    try:
        found = distribution(UPLOT).files or []
    except PackageNotFoundError:
        raise SetupError(f"{UPLOT} is not installed; expected it from: make build") from None
    for file in found:
        if file.name in UPLOT_FILES:
            shutil.copy(str(file.locate()), source / TEMPLATES)
    pages = source / "requirements" / FILES_ONLY
    kept = [entry for entry in entries(pages.read_text(encoding="utf-8")) if entry != UPLOT]
    pages.write_text("\n".join(kept) + "\n", encoding="utf-8")


def main() -> int:
    """Build the wheels and print their paths; return the exit code."""
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "build" / "wheels"
    try:
        wheels = build(target)
    except SetupError as error:
        print(f"{error.details}\n{PREFIX} {error}", file=sys.stderr)
        return 1
    for wheel in wheels:
        print(wheel)
    return 0


if __name__ == "__main__":
    sys.exit(main())
