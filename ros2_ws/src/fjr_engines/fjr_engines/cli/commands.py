# SPDX-License-Identifier: Apache-2.0
"""Declare the commands on files of engines; the code behind each is imported when it runs.

MuJoCo is imported with it, so that the other commands need none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from fjr_msgs_py.console import options
from fjr_msgs_py.console.options import command, implementation, set_option
from fjr_msgs_py.console.output import Result, plural


@command("export-mjcf")
@click.argument("scenario", shell_complete=options.complete_scenario)
@click.argument("file", metavar="FILE.xml", type=options.PATH)
@click.option("--force", is_flag=True, help="Replace an earlier export; other files are kept.")
@set_option
def export_mjcf(**given: Any) -> Any:
    """Export a robot as an MJCF for MuJoCo.

    SCENARIO is the name of an installed scenario or a YAML file. Both sides of each joint are in the file: `<joint>` of
    the link, `<joint>_motor` of the rotor with its motor, between them the tendon `<joint>_spring`. Meshes are written
    to FILE_meshes. The keyframe `start` is the initial state of the scenario.
    """
    return exported(**given)


def exported(scenario: str, assignments: Sequence[str], file: Path, force: bool) -> Result:
    """Write the MJCF and its meshes; force: replace earlier ones. Raises FjrError."""
    load = implementation("fjr_msgs_py.scenarios.library").load
    contents, notes = implementation("fjr_engines.mjcf.export").mjcf(load(scenario, assignments), file.stem)
    paths = [file, *(file.parent / each for each in list(contents)[1:])]
    write(dict(zip(paths, contents.values(), strict=True)), force)
    lines = [
        f"{file}: {plural(len(paths) - 1, 'mesh', 'meshes')} beside it",
        *(f"note  {note}" for note in notes),
        f"view  python -m mujoco.viewer --mjcf={file}",
        "ros2  mujoco_ros2_control: command interface <joint>_motor/effort, states of <joint> and <joint>_motor",
        f"back  fjr new {file}",
    ]
    return Result("\n".join(lines), {"file": file, "files": paths, "notes": notes})


def write(contents: Mapping[Path, bytes], force: bool) -> None:
    """Write files; raise ExportError for one that exists, unless it may be replaced, or that cannot be written."""
    error = implementation("fjr_design.exports.project").ExportError
    for path in contents:
        if path.exists() and not force:
            raise error(f"{path} exists; expected a new file (--force replaces an earlier export)")
    try:
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    except OSError as failure:
        raise error(f"cannot write {path}: {failure.strerror}") from None
