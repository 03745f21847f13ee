# SPDX-License-Identifier: Apache-2.0
"""`fjr export-c` and `fjr description`: a scenario in other languages, C99 and URDF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fjr_bringup.result import Result
from fjr_bringup.scenarios import library
from fjr_core.codegen import export, loop_of, prefix_of, write
from fjr_core.config.description import description
from fjr_core.config.scenario import left_out


def describe(scenario: str | None, assignments: Sequence[str]) -> Result:
    """Return the robot of a scenario as URDF."""
    urdf = description(library.load(scenario, assignments).plant_values)
    return Result(urdf.removesuffix("\n"), {"urdf": urdf})


def export_scenario(scenario: str, assignments: Sequence[str], folder: Path, prefix: str | None, force: bool) -> Result:
    """Write law, plant and reference of a scenario as C99; force: replace an earlier export. Raises FjrError."""
    loaded = library.load(scenario, assignments)
    missing = left_out(loaded)
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
        text += f"\nnot exported: what {', '.join(missing)} add to plant and measurement"
    return Result(text, {"folder": folder, "files": list(texts), "not_exported": list(missing)})
