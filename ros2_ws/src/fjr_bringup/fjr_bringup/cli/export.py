# SPDX-License-Identifier: Apache-2.0
"""`fjr export-c` and `fjr description`: a scenario in other languages, C99 and URDF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fjr_bringup.scenarios import library
from fjr_core.codegen import export, loop_of, prefix_of, write
from fjr_core.config.description import description
from fjr_core.config.scenario import Scenario, left_out


def print_description(scenario: str | None, assignments: Sequence[str]) -> None:
    """Print the robot of a scenario as URDF."""
    print(description(library.load(scenario, assignments).plant_values), end="")


def export_scenario(scenario: str, assignments: Sequence[str], folder: Path, prefix: str | None, force: bool) -> None:
    """Write the C99 folder of a scenario; force: replace an earlier export."""
    print(export_to(library.load(scenario, assignments), folder, prefix, force))


def export_to(scenario: Scenario, folder: Path, prefix: str | None, force: bool) -> str:
    """Write law, plant and reference as C99; return the message for the user. Raises FjrError."""
    prefix = prefix or prefix_of(scenario.name)
    missing = left_out(scenario)
    texts = export(loop_of(scenario), prefix, notes=_note(missing))
    write(texts, folder, force)
    lines = [
        f"{folder}: {', '.join(texts)}",
        f"build and compare with Python: cmake -S {folder} -B {folder}/build && cmake --build {folder}/build && "
        f"ctest --test-dir {folder}/build --verbose",
    ]
    if missing:
        lines.append(f"not exported: what {', '.join(missing)} add to plant and measurement")
    return "\n".join(lines)


def _note(missing: Sequence[str]) -> str:
    """Return a sentence for the README about parameters of the scenario that the C code leaves out."""
    names = ", ".join(f"`{name}`" for name in missing)
    return f"\nThe scenario also sets {names}: not in this C.\n" if missing else ""
