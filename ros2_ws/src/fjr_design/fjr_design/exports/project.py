# SPDX-License-Identifier: Apache-2.0
"""Export a closed loop as plain C99: control step and plant for C and C++ programs, with a case to replay.

The control step of a scenario is the text of fjr_core/runtime/, its mathematics and its constants:

runtime/*.c, step.h   unchanged            model.h, model.c   sizes, limits, gains, reference
control_step.c        includes them        casadi.c           law, gravity, observer
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.errors import FjrError, StateError, TrajectoryError
from fjr_core.law.interfaces import ARGUMENTS, StaticLaw
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.monitoring.certificate import OUTPUTS
from fjr_core.motions.reference import Reference
from fjr_core.numerics import integrators
from fjr_core.numerics.symbolic import dense_function
from fjr_core.runtime.library import HEADER, SOURCES, model_functions, text
from fjr_core.runtime.reference import ReferenceTable, reference_table

from .c_code import casadi_code, checked_prefix, filled, number, numbers, work_sizes

SAMPLES = 200  # of the simulation that the exported code repeats
PREFIX = "fjr"  # prefix of all names of the step in C
CALLED = {"arg": len(ARGUMENTS), "res": len(OUTPUTS), "iw": 1, "w": 1}
"""Least sizes of the work space: arguments of a SampledLaw, results of a certificate, which the step always passes."""
KNOWN = "Sine, MultiSine, PointToPoint, Circle, Hold, Spline, SampledMotion, joined or shifted"


class ExportError(FjrError):
    """Folder to which an export cannot be written."""


def export(scenario: Scenario, prefix: str, samples: int = SAMPLES, notes: str = "") -> dict[str, str]:
    """Return the texts of all files by name; notes: Markdown at the end of the README.

    Raises ParameterError for an invalid prefix, TrajectoryError for a reference that is not built in, StateError for a
    law or plant in Python and if the loop diverges within the samples of the case, CompilerError without a C compiler.
    """
    prefix, scenario = checked_prefix(prefix), exportable(scenario)
    step = step_code(scenario, plant_functions(scenario.plant))
    texts = {
        f"{prefix}.h": step["model.h"],
        f"{prefix}.c": step["model.c"],
        f"{prefix}_step.h": step["step.h"],
        f"{prefix}_step.c": "\n".join(['#include "model.h"\n', *map(step.__getitem__, SOURCES)]),
        f"{prefix}_casadi.c": step["casadi.c"],
        **filled("templates", scenario=scenario, prefix=prefix, samples=samples, notes=notes),
    }
    texts = {name: _renamed(text, prefix) for name, text in texts.items()}
    return texts | {"case.txt": recorded_case(scenario, samples)}


def _renamed(text: str, prefix: str) -> str:
    """Return a C text with another prefix of all names and files, so that one program can contain several exports."""
    for name, file in (("model.h", f"{prefix}.h"), ("step.h", f"{prefix}_step.h")):
        text = re.sub(rf"(?<![\w/]){re.escape(name)}\b", file, text)
    text = re.sub(rf"\b{PREFIX}_", f"{prefix}_", text)
    return re.sub(rf"\b{PREFIX.upper()}_", f"{prefix.upper()}_", text)


def recorded_case(scenario: Scenario, samples: int) -> str:
    """Run the closed loop and return what the control step reads and the effort it gives.

    A line for each sample: stamp and arrival [ns], then in hexadecimal, which is exact, link positions [rad], motor
    angles [rad] or joint torques [N m], velocities [rad/s] and effort [N m]. Raises StateError if the loop diverges.
    """
    step, plant, measured = scenario.control_step(compile=True), scenario.plant, scenario.measurement
    n, period = plant.robot.n, scenario.sample_period
    ratio = np.asarray(measured.gear_ratio)
    x, lines = np.asarray(scenario.x0, dtype=float), []
    for k in range(samples):
        stamp = round(k * period * 1e9)
        q_l, q_m, (dq_l, dq_m) = x[:n].copy(), x[n : 2 * n], plant.robot.velocities(x)
        motor = plant.robot.K @ (q_m - q_l) if measured.by_torque else q_m * ratio
        step.step(stamp, stamp, q_l, motor, dq_l, dq_m * ratio)
        sample = np.concatenate([q_l, motor, dq_l, dq_m * ratio, step.u]).tolist()
        lines.append(" ".join([str(stamp), str(stamp), *map(float.hex, sample)]))
        u = step.u.copy()
        for _ in range(scenario.inner_steps):
            x = plant.step(x, u, period / scenario.inner_steps)
        if step.controller.journal.not_finite or not np.isfinite(x).all():
            raise StateError(
                f"the loop diverged at t = {k * period:.6g} s; "
                "expected a loop that is stable at its sample period (fjr check)"
            )
    return "\n".join(lines) + "\n"


def write(contents: Mapping[str, str | bytes], folder: Path, force: bool = False, beside: bool = False) -> None:
    """Write the files; raises ExportError for a folder that is not empty or not writable.

    force: accept a folder that is not empty; files of the same names are replaced, others are kept. beside: other files
    are accepted without it.
    """
    try:
        if beside:
            taken = [f"{path} exists; expected a new file" for path in map(folder.joinpath, contents) if path.exists()]
        else:
            empty = folder.is_dir() and not any(folder.iterdir())
            what = "is not empty" if folder.is_dir() else "is not a folder"
            taken = [] if empty or not folder.exists() else [f"{folder} {what}; expected a new or empty folder"]
        if taken and not force:
            raise ExportError(f"{taken[0]} (--force replaces an earlier export)")
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    except OSError as error:
        raise ExportError(f"cannot write to {folder}: {error.strerror}") from None


def exportable(scenario: Scenario) -> Scenario:
    """Return the scenario with functions that are not compiled, so that C can be generated from them.

    Raises StateError for a law or plant in Python.
    """
    made = replace(scenario, controller_values={**scenario.controller_values, "compile": False})
    for name, part in (("law", made.law), ("plant", made.plant)):
        if part.in_python:
            raise StateError(f"the {name} is written in Python; expected one made of expressions, to export it to C")
    return made


def plant_functions(plant: Plant) -> dict[str, ca.Function]:
    """Return the functions of a plant by their names in C, not compiled.

    plant_measure: x (4n,) -> position (q_l, q_m), velocity (dq_l, dq_m), each (2n,).
    """
    n = plant.robot.n
    x = ca.SX.sym("x", 4 * n)
    signals = {"position": x[: 2 * n], "velocity": ca.vertcat(*plant.robot.velocity_expressions(x))}
    return {
        "plant_measure": dense_function("measure", {"x": x}, signals, cse=True),
        "plant_step": integrators.step(plant.integrator, plant.dynamics, as_c=True),
    }


def step_code(scenario: Scenario, more: Mapping[str, ca.Function]) -> dict[str, str]:
    """Return the texts of the step of an `exportable` scenario by file name, without ROS.

    more: functions that are written as fjr_casadi_<name>, too. Raises TrajectoryError for a reference that is not built
    in, CompilerError without a C compiler.
    """
    own = model_functions(scenario.sampled_law, scenario.observer)
    functions = {**own, **more}
    sizes = work_sizes(PREFIX, functions)
    sizes = {size: max(sizes[size], least) for size, least in CALLED.items()}
    step, names = scenario.control_step(compile=True), {name: f"{PREFIX}_casadi_{name}" for name in own}
    texts = filled(
        "step_templates",
        scenario=scenario,
        law=scenario.sampled_law,
        functions=own,
        sizes=sizes,
        gain_words=_gain_words(scenario.law),
        settings=_initialisers(step.ffi, step.controller.settings, {}),
        model=_initialisers(step.ffi, step.model, names),
        reference=reference_code(scenario.reference, "reference"),
        sources=SOURCES,
    )
    return {**texts, **{name: text(name) for name in (HEADER, *SOURCES)}, "casadi.c": casadi_code(PREFIX, functions)}


def _initialisers(ffi: Any, struct: Any, functions: Mapping[str, str]) -> str:
    """Format designated initialisers of a structure in memory: its numbers, and functions by field."""
    kind, rows = ffi.typeof(struct), []
    for name, field in (kind.item if kind.kind == "pointer" else kind).fields:
        value = getattr(struct, name)
        if name in functions:
            rows.append((name, functions[name]))
        elif field.type.kind == "array":
            rows.append((name, f"{{{numbers(np.array(list(value)))}}}"))
        elif field.type.kind == "primitive":
            rows.append((name, number(value) if isinstance(value, float) else str(value)))
    return "\n".join(f"    .{name} = {value}," for name, value in rows)


def _gain_words(law: StaticLaw) -> str:
    """Describe the layout of the gains of a v-dPBC law as a C comment; an empty string for other laws."""
    if not isinstance(law, TrackingLaw):
        return ""
    parts = [f"{name} ({symbol.nnz()})" for name, symbol in law.symbols.by_name.items()]
    half = math.ceil(len(parts) / 2)
    lines = (", ".join(parts[:half]), ", ".join(parts[half:]))
    meaning = "n numbers are a diagonal, n*n a matrix by columns. Pi_m_inverse must be that of Pi_m."
    return "\n/* " + ",\n * ".join(lines) + f";\n * {meaning} */"


def reference_code(reference: Reference, name: str) -> str:
    """Return C definitions that end with `static const struct fjr_reference <name>`; they need step.h and math.h.

    All other definitions have names that start with <name>_. Raises TrajectoryError for a reference that is not built
    in.
    """
    return "\n".join(_reference_definitions(reference_table(reference), name))


def _reference_definitions(table: ReferenceTable, name: str) -> Iterator[str]:
    """Yield the definitions of a table, those to which it refers first."""
    if table.function is not None:
        kind = type(table.function).__name__
        raise TrajectoryError(f"a reference {kind} cannot be exported to C; expected one of {KNOWN}")
    if table.then is not None:
        yield from _reference_definitions(table.then, f"{name}_then")
    for field, array in table.arrays.items():
        yield f"static const double {name}_{field}[{array.size}] = {{\n    {numbers(array)}}};"
    fields = ",\n".join(f"    .{field} = {value}" for field, value in _reference_fields(table, name))
    yield f"static const struct fjr_reference {name} = {{\n{fields}}};\n"


def _reference_fields(table: ReferenceTable, name: str) -> Iterator[tuple[str, str]]:
    """Yield the fields that are not zero, as C."""
    yield "kind", table.kind
    for field in ("shift", "end", "period", "radius"):
        if value := float(getattr(table, field)):
            yield field, number(value)
    yield "position", f"{{{numbers(table.position)}}}"
    arrays = {field: f"{name}_{field}" for field in table.arrays}
    if "amplitude" in arrays:
        yield "terms", str(len(table.arrays["amplitude"]))
        yield from arrays.items()
    elif arrays:
        yield "polynomials", f"{{{', '.join([str(len(table.arrays['edge'])), *arrays.values()])}}}"
    if table.then is not None:
        yield "until", number(float(table.until))
        yield "then", f"&{name}_then"
