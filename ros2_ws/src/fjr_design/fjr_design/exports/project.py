# SPDX-License-Identifier: Apache-2.0
"""Export a closed loop as plain C99: control step and plant for C and C++ programs, with a case to replay."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.errors import FjrError, StateError
from fjr_core.runtime.library import SOURCES

from .c_code import checked_prefix, comment, filled, number, numbers
from .step_code import PREFIX, exportable, plant_functions, step_code

SAMPLES = 200


class ExportError(FjrError):
    """Folder to which an export cannot be written."""


def export(scenario: Scenario, prefix: str, samples: int = SAMPLES, notes: str = "") -> dict[str, str]:
    """Return the texts of all files by name; notes: Markdown at the end of the README.

    Raises ParameterError for an invalid prefix, TrajectoryError for a reference that is not built in, StateError for a
    law or plant in Python and if the loop diverges within the samples of the case, CompilerError without a C compiler.
    """
    prefix, scenario = checked_prefix(prefix), exportable(scenario)
    values = {
        "prefix": prefix,
        "title": comment(scenario.name),
        "joint_list": comment(", ".join(scenario.joints)),
        "x0_numbers": numbers(scenario.x0),
        "sample_period": number(scenario.sample_period),
        "inner_steps": str(scenario.inner_steps),
        "integrator": scenario.plant.integrator,
        "samples": str(samples),
        "notes": notes,
    }
    step = step_code(scenario, plant_functions(scenario.plant))
    texts = {
        f"{prefix}.h": step["model.h"],
        f"{prefix}.c": step["model.c"],
        f"{prefix}_step.h": step["step.h"],
        f"{prefix}_step.c": "\n".join(['#include "model.h"\n', *map(step.__getitem__, SOURCES)]),
        f"{prefix}_casadi.c": step["casadi.c"],
        **filled("templates", values),
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
