# SPDX-License-Identifier: Apache-2.0
"""Export a closed loop as plain C99: control step and plant for C and C++ programs, with a case to replay."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.errors import FjrError, StateError
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.numerics import integrators
from fjr_core.numerics.checks import Array
from fjr_core.numerics.symbolic import dense_function
from fjr_core.runtime.library import SOURCES

from .c_code import checked_prefix, comment, filled, number, numbers
from .step_code import PREFIX, ExportedController, controller_of, step_code

SAMPLES = 200
TEMPLATES = {
    "plant.h": "{}_plant.h",
    "plant.c": "{}_plant.c",
    **{name: name for name in ("replay.c", "CMakeLists.txt", "README.md")},
}
"""Templates and the files that they become, named after the prefix."""


class ExportError(FjrError):
    """Folder to which an export cannot be written."""


@dataclass(frozen=True, eq=False)
class ExportedLoop:
    """Sampled closed loop of a controller and a plant with its initial state x0 (4n,).

    inner_steps: steps of the plant per sample. Raises StateError if controller and plant differ in the number of
    joints, and for a plant in Python.
    """

    controller: ExportedController
    plant: Plant
    x0: Array
    inner_steps: int

    def __post_init__(self) -> None:
        n = [self.controller.n, self.plant.robot.n, np.size(self.x0) / 4]
        if len(set(n)) != 1:
            raise StateError(f"controller, plant and x0 have {n} joints; expected equal numbers")
        if self.plant.in_python:
            raise StateError("the plant is written in Python; expected one made of expressions, to export it to C")

    @property
    def plant_functions(self) -> dict[str, ca.Function]:
        """Return the functions of the plant by their names in C, not compiled.

        plant_measure: x (4n,) -> position (q_l, q_m), velocity (dq_l, dq_m), each (2n,).
        """
        n = self.plant.robot.n
        x = ca.SX.sym("x", 4 * n)
        signals = {"position": x[: 2 * n], "velocity": ca.vertcat(*self.plant.robot.velocity_expressions(x))}
        return {
            "plant_measure": dense_function("measure", {"x": x}, signals, cse=True),
            "plant_step": integrators.step(self.plant.integrator, self.plant.dynamics, as_c=True),
        }


def loop_of(scenario: Scenario) -> ExportedLoop:
    """Return the closed loop of a scenario with its controller and an ideal plant; raises FjrError."""
    steps = int(scenario.plant_values["inner_steps"])  # type: ignore[arg-type]
    return ExportedLoop(controller_of(scenario), scenario.plant, scenario.x0, steps)


def export(loop: ExportedLoop, prefix: str, samples: int = SAMPLES, notes: str = "") -> dict[str, str]:
    """Return the texts of all files by name; notes: Markdown at the end of the README.

    Raises ParameterError for an invalid prefix, TrajectoryError for a reference that is not built in, StateError if the
    loop diverges within the samples of the case, CompilerError without a C compiler.
    """
    prefix, controller = checked_prefix(prefix), loop.controller
    values = {
        "prefix": prefix,
        "title": comment(controller.name),
        "joint_list": comment(", ".join(controller.joints)),
        "x0_numbers": numbers(loop.x0),
        "sample_period": number(controller.sample_period),
        "inner_steps": str(loop.inner_steps),
        "integrator": loop.plant.integrator,
        "samples": str(samples),
        "notes": notes,
    }
    step = step_code(controller, loop.plant_functions)
    texts = {
        f"{prefix}.h": step["model.h"],
        f"{prefix}.c": step["model.c"],
        f"{prefix}_step.h": step["step.h"],
        f"{prefix}_step.c": "\n".join(['#include "model.h"\n', *map(step.__getitem__, SOURCES)]),
        f"{prefix}_casadi.c": step["casadi.c"],
        **{file.format(prefix): filled(template, values) for template, file in TEMPLATES.items()},
    }
    texts = {name: _renamed(text, prefix) for name, text in texts.items()}
    return texts | {"case.txt": recorded_case(controller, loop.plant, loop.x0, loop.inner_steps, samples)}


def _renamed(text: str, prefix: str) -> str:
    """Return a C text with another prefix of all names and files, so that one program can contain several exports."""
    for name, file in (("model.h", f"{prefix}.h"), ("step.h", f"{prefix}_step.h")):
        text = re.sub(rf"(?<![\w/]){re.escape(name)}\b", file, text)
    text = re.sub(rf"\b{PREFIX}_", f"{prefix}_", text)
    return re.sub(rf"\b{PREFIX.upper()}_", f"{prefix.upper()}_", text)


def recorded_case(controller: ExportedController, plant: Plant, x0: Array, inner_steps: int, samples: int) -> str:
    """Run the closed loop from x0 (4n,) and return what the control step reads and the effort it gives.

    A line for each sample: stamp and arrival [ns], then in hexadecimal, which is exact, link positions [rad], motor
    angles [rad] or joint torques [N m], velocities [rad/s] and effort [N m]. Raises StateError if the loop diverges.
    """
    step, n, period = controller.step(), controller.n, controller.sample_period
    measurement, ratio = controller.measurement, np.asarray(controller.measurement.gear_ratio)
    x, lines = np.asarray(x0, dtype=float), []
    for k in range(samples):
        stamp = round(k * period * 1e9)
        q_l, q_m, (dq_l, dq_m) = x[:n].copy(), x[n : 2 * n], plant.robot.velocities(x)
        motor = plant.robot.K @ (q_m - q_l) if measurement.by_torque else q_m * ratio
        step.step(stamp, stamp, q_l, motor, dq_l, dq_m * ratio)
        sample = np.concatenate([q_l, motor, dq_l, dq_m * ratio, step.u]).tolist()
        lines.append(" ".join([str(stamp), str(stamp), *map(float.hex, sample)]))
        u = step.u.copy()
        for _ in range(inner_steps):
            x = plant.step(x, u, period / inner_steps)
        if step.controller.journal.not_finite or not np.isfinite(x).all():
            raise StateError(
                f"the loop diverged at t = {k * period:.6g} s; "
                "expected a loop that is stable at its sample period (fjr check)"
            )
    return "\n".join(lines) + "\n"


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
