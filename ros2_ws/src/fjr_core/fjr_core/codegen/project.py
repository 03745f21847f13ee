# SPDX-License-Identifier: Apache-2.0
"""The files of an export, and the folder that they are written to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from importlib.resources import files
from pathlib import Path
from string import Template

from ..control.sampled_law import SampledLaw, Static
from ..control.vdpbc.law import TrackingLaw
from ..control.vdpbc.symbolic_gains import GainSymbols, GainTerms
from ..errors import FjrError
from .c_code import casadi_code, checked_prefix, comment, number, numbers, quoted, strings, work_sizes
from .exported_loop import Loop
from .replay_case import as_csv, recorded

SAMPLES = 200
TEMPLATES = {"header.h": "{}.h", "source.c": "{}.c"}
"""Templates whose file is named after the prefix; the others keep their names."""
AS_THEY_ARE = ("replay.c", "CMakeLists.txt", "README.md")


class ExportError(FjrError):
    """A folder that an export cannot be written to."""


class _CTemplate(Template):
    """@{name} stands for a value: C, CMake and Markdown have their own uses for `$`."""

    delimiter = "@"


def export(loop: Loop, prefix: str, samples: int = SAMPLES, notes: str = "") -> dict[str, str]:
    """The texts of all files by name; notes: Markdown that ends the README.

    Raises ParameterError for a prefix that C names cannot begin with, TrajectoryError for a reference of another kind
    than the built-in ones, StateError where the loop diverges within the samples of the case.
    """
    prefix = checked_prefix(prefix)
    words = {**_words(loop, prefix), "samples": str(samples), "notes": notes}
    texts = {TEMPLATES.get(name, name).format(prefix): _filled(name, words) for name in (*TEMPLATES, *AS_THEY_ARE)}
    texts[f"{prefix}_casadi.c"] = casadi_code(prefix, loop.functions)
    texts["case.csv"] = as_csv(recorded(loop, samples))
    return texts


def write(texts: Mapping[str, str], folder: Path, force: bool = False) -> None:
    """Write the files; raises ExportError for a folder that is not empty, unless force, or not to be written to.

    force: files of the same names are replaced, others left alone.
    """
    try:
        if folder.exists() and not force and (not folder.is_dir() or any(folder.iterdir())):
            what = "is not empty" if folder.is_dir() else "is not a folder"
            raise ExportError(f"{folder} {what}; expected a new or empty folder (--force replaces an earlier export)")
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise ExportError(f"cannot write to {folder}: {error.strerror}") from None


def _filled(template: str, words: Mapping[str, str]) -> str:
    text = (files("fjr_core.codegen") / "templates" / f"{template}.in").read_text(encoding="utf-8")
    return _CTemplate(text).substitute(words)


def _words(loop: Loop, prefix: str) -> dict[str, str]:
    """What the templates' names stand for."""
    law, plant = loop.law, loop.plant
    memory, gains = len(law.memory), len(law.gain_values)
    return {
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "indent": " " * len(f"int {prefix}_law("),
        "title": comment(loop.name),
        "title_literal": quoted(loop.name),
        "joint_list": comment(", ".join(loop.joints)),
        "joint_literals": strings(loop.joints),
        "n": str(loop.n),
        "gains": str(gains),
        "gains_length": str(max(1, gains)),
        "gain_words": _gain_words(law),
        "gain_numbers": numbers(law.gain_values),
        "memory": str(memory),
        "memory_length": str(max(1, memory)),
        "memory_words": "" if memory else "; it has none, and this one entry is not used",
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
    """How many numbers each gain of the v-dPBC law has in `gains`; nothing for other laws."""
    if not (isinstance(law, Static) and isinstance(law.law, TrackingLaw)):
        return ""
    terms = GainSymbols(law.law.gains).terms
    parts = [f"{field.name} ({getattr(terms, field.name).nnz()})" for field in fields(GainTerms)]
    half = len(parts) // 2
    lines = (", ".join(parts[:half]), ", ".join(parts[half:]))
    meaning = "n numbers are a diagonal, n*n a matrix by columns. Pi_m_inverse must be that of Pi_m."
    return ":\n * " + ",\n * ".join(lines) + f";\n * {meaning}"
