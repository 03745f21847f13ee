# SPDX-License-Identifier: Apache-2.0
"""`fjr export-c`, `fjr export-ros2-control` and `fjr description`: a scenario as C99, for ros2_control and as URDF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fjr_core.config.description import description
from fjr_core.config.scenario import left_out
from fjr_design.exports.c_code import prefix_of
from fjr_design.exports.project import export, loop_of, write
from fjr_design.exports.ros2_control.arm import not_exported
from fjr_design.exports.ros2_control.package import export_package, package_name_of
from fjr_msgs_py.console.result import Result
from fjr_msgs_py.scenarios import library


def describe(scenario: str | None, assignments: Sequence[str]) -> Result:
    """Return the robot of a scenario as URDF."""
    urdf = description(library.load(scenario, assignments, robot_only=True).plant_values)
    return Result(urdf.removesuffix("\n"), {"urdf": urdf})


def export_scenario(scenario: str, assignments: Sequence[str], folder: Path, prefix: str | None, force: bool) -> Result:
    """Write control step and plant of a scenario as C99; force: replace an earlier export. Raises FjrError."""
    loaded = library.load(scenario, assignments)
    missing = [name for name in left_out(loaded) if name in loaded.plant_values]
    names = ", ".join(f"`{name}`" for name in missing)
    notes = f"\nThe scenario also sets {names}: not in this C.\n" if missing else ""
    texts = export(loop_of(loaded), prefix or prefix_of(loaded.name), notes=notes)
    write(texts, folder, force)
    text = (
        f"{folder}: {', '.join(texts)}\n"
        f"build and compare with Python: cmake -S {folder} -B {folder}/build && cmake --build {folder}/build && "
        f"ctest --test-dir {folder}/build --verbose"
    )
    if missing:
        text += f"\nnot exported: what {', '.join(missing)} add to the plant"
    return Result(text, {"folder": folder, "files": list(texts), "not_exported": list(missing)})


def export_ros2_control(
    scenario: str, assignments: Sequence[str], folder: Path, package: str | None, force: bool
) -> Result:
    """Write a package for ros2_control; force: replace an earlier export. Raises FjrError."""
    loaded = library.load(scenario, assignments)
    name = package or package_name_of(loaded.name)
    texts = export_package(loaded, name)
    write(texts, folder, force)
    missing = not_exported(loaded)
    text = (
        f"{folder}: package {name}, {len(texts)} files\n"
        f"build and test it where ros2_control is installed: colcon build --base-paths {folder} && "
        f"colcon test --base-paths {folder}"
    )
    if missing:
        text += f"\nnot exported: {', '.join(missing)} of the simulated robot"
    return Result(text, {"folder": folder, "package": name, "files": list(texts), "not_exported": missing})
