# SPDX-License-Identifier: Apache-2.0
"""Write the files of an export to a folder."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from string import Template

from ..control.sampled_law import AsSampledLaw, SampledLaw
from ..control.vdpbc.law import TrackingLaw
from ..errors import FjrError
from .c_code import casadi_code, checked_prefix, comment, number, numbers, quoted, work_sizes
from .exported_loop import Loop
from .replay_case import as_csv, recorded

SAMPLES = 200
TEMPLATES = {"header.h": "{}.h", "source.c": "{}.c"}
"""Templates whose file name contains the prefix; the others keep their names."""
AS_THEY_ARE = ("replay.c", "CMakeLists.txt", "README.md")


class ExportError(FjrError):
    """Folder to which an export cannot be written."""


class _CTemplate(Template):
    """Template with @{name} for values, since C, CMake and Markdown use `$` themselves."""

    delimiter = "@"


def export(loop: Loop, prefix: str, samples: int = SAMPLES, notes: str = "") -> dict[str, str]:
    """Return the texts of all files by name; notes: Markdown at the end of the README.

    Raises ParameterError for an invalid prefix, TrajectoryError for a reference that is not built in, StateError if the
    loop diverges within the samples of the case.
    """
    prefix = checked_prefix(prefix)
    values = {**_values(loop, prefix), "samples": str(samples), "notes": notes}
    texts = {TEMPLATES.get(name, name).format(prefix): _filled(name, values) for name in (*TEMPLATES, *AS_THEY_ARE)}
    texts[f"{prefix}_casadi.c"] = casadi_code(prefix, loop.functions)
    texts["case.csv"] = as_csv(recorded(loop, samples))
    return texts


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


def _filled(template: str, values: Mapping[str, str]) -> str:
    text = (files("fjr_core.codegen") / "templates" / f"{template}.in").read_text(encoding="utf-8")
    return _CTemplate(text).substitute(values)


def _values(loop: Loop, prefix: str) -> dict[str, str]:
    """Return the values of the names in the templates."""
    law, plant = loop.law, loop.plant
    memory, gains = len(law.memory), len(law.gain_values)
    return {
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "indent": " " * len(f"int {prefix}_law("),
        "title": comment(loop.name),
        "title_literal": quoted(loop.name),
        "joint_list": comment(", ".join(loop.joints)),
        "joint_literals": ", ".join(map(quoted, loop.joints)),
        "n": str(loop.n),
        "gains": str(gains),
        "gains_length": str(max(1, gains)),
        "gain_words": _gain_words(law),
        "gain_numbers": numbers(law.gain_values),
        "memory": str(memory),
        "memory_length": str(max(1, memory)),
        "memory_words": "" if memory else "; it has none, and this entry is not used",
        "memory_numbers": numbers(law.memory),
        "x0_numbers": numbers(loop.x0),
        "sample_period": number(loop.sample_period),
        "lead": number(law.lead),
        "inner_steps": str(loop.inner_steps),
        "integrator": plant.integrator,
        "kept": str(max(4 * loop.n, memory)),
        **{size: str(value) for size, value in work_sizes(prefix, loop.functions).items()},
    }


def _gain_words(law: SampledLaw) -> str:
    """Describe the layout of `gains` of a v-dPBC law; an empty string for other laws."""
    if not (isinstance(law, AsSampledLaw) and isinstance(law.law, TrackingLaw)):
        return ""
    parts = [f"{name} ({symbol.nnz()})" for name, symbol in law.law.symbols.by_name.items()]
    half = len(parts) // 2
    lines = (", ".join(parts[:half]), ", ".join(parts[half:]))
    meaning = "n numbers are a diagonal, n*n a matrix by columns. Pi_m_inverse must be that of Pi_m."
    return ":\n * " + ",\n * ".join(lines) + f";\n * {meaning}"
