# SPDX-License-Identifier: Apache-2.0
"""Write the files of an export to a folder."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from fjr_core.errors import FjrError
from fjr_core.runtime.library import SOURCES

from .c_code import checked_prefix, comment, number, numbers
from .exported_loop import Loop
from .filled_template import filled
from .recorded_steps import as_text, recorded_steps
from .step_code import PREFIX, step_code

SAMPLES = 200
NAMED = {"plant.h": "{}_plant.h", "plant.c": "{}_plant.c"}
"""Templates whose file name contains the prefix; the others keep their names."""
AS_THEY_ARE = ("replay.c", "CMakeLists.txt", "README.md")


class ExportError(FjrError):
    """Folder to which an export cannot be written."""


def export(loop: Loop, prefix: str, samples: int = SAMPLES, notes: str = "") -> dict[str, str]:
    """Return the texts of all files by name; notes: Markdown at the end of the README.

    Raises ParameterError for an invalid prefix, TrajectoryError for a reference that is not built in, StateError if the
    loop diverges within the samples of the case, CompilerError without a C compiler.
    """
    prefix = checked_prefix(prefix)
    values = {**_values(loop, prefix), "samples": str(samples), "notes": notes}
    step = step_code(loop.controller, loop.plant_functions)
    texts = {
        f"{prefix}.h": step["model.h"],
        f"{prefix}.c": step["model.c"],
        f"{prefix}_step.h": step["step.h"],
        f"{prefix}_step.c": "\n".join(['#include "model.h"\n', *map(step.__getitem__, SOURCES)]),
        f"{prefix}_casadi.c": step["casadi.c"],
    }
    texts = {name: renamed(text, prefix) for name, text in texts.items()}
    texts |= {
        NAMED.get(name, name).format(prefix): renamed(filled(name, values), prefix) for name in (*NAMED, *AS_THEY_ARE)
    }
    steps = recorded_steps(loop.controller, loop.plant, loop.x0, loop.inner_steps, samples)
    return texts | {"case.txt": as_text(steps)}


def renamed(text: str, prefix: str) -> str:
    """Return a C text with another prefix of all names and files, so that one program can contain several exports."""
    for name, file in (("model.h", f"{prefix}.h"), ("step.h", f"{prefix}_step.h")):
        text = re.sub(rf"(?<![\w/]){re.escape(name)}\b", file, text)
    text = re.sub(rf"\b{PREFIX}_", f"{prefix}_", text)
    return re.sub(rf"\b{PREFIX.upper()}_", f"{prefix.upper()}_", text)


def write(texts: Mapping[str, str], folder: Path, force: bool = False) -> None:
    """Write the files; raises ExportError for a folder that is not empty or not writable.

    force: accept a folder that is not empty; files of the same names are replaced, others are kept.
    """
    try:
        if folder.exists() and not force and (not folder.is_dir() or any(folder.iterdir())):
            what = "is not empty" if folder.is_dir() else "is not a folder"
            raise ExportError(f"{folder} {what}; expected a new or empty folder (--force replaces an earlier export)")
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise ExportError(f"cannot write to {folder}: {error.strerror}") from None


def _values(loop: Loop, prefix: str) -> dict[str, str]:
    """Return the values of the names in the templates."""
    controller = loop.controller
    return {
        "prefix": prefix,
        "title": comment(loop.name),
        "joint_list": comment(", ".join(controller.joints)),
        "x0_numbers": numbers(loop.x0),
        "sample_period": number(controller.sample_period),
        "inner_steps": str(loop.inner_steps),
        "integrator": loop.plant.integrator,
    }
