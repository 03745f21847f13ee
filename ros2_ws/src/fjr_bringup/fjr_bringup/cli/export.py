# SPDX-License-Identifier: Apache-2.0
"""`fjr export-c`: a scenario's law, plant and reference as a folder of C99."""

from __future__ import annotations

from pathlib import Path

from fjr_core.codegen import export, loop_of, prefix_of, write
from fjr_core.config.scenario import Scenario, left_out


def export_to(scenario: Scenario, folder: Path, prefix: str | None, force: bool) -> str:
    """Write the folder; returns what to tell. Raises FjrError."""
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
        lines.append(f"not in the C: what {', '.join(missing)} add to plant and measurement")
    return "\n".join(lines)


def _note(missing: list[str]) -> str:
    """A sentence for the README on what the scenario has and the C has not."""
    return f"\nThe scenario also sets {', '.join(f'`{name}`' for name in missing)}: not in this C.\n" if missing else ""
