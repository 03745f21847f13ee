# SPDX-License-Identifier: Apache-2.0
"""Efforts of a recorded sequence from an exported C project and from an exported controller of ros2_control."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np

from design.exports.c_program import C99, built
from design.exports.ros2_control import exported_package
from fjr_core.config.scenario import Scenario
from fjr_core.runtime.library import step_library
from fjr_design.exports.project import export, write
from fjr_design.exports.step_code import loop_of
from hosts.inputs import Sequence
from hosts.step_hosts import Efforts, changes
from time_limits import HANG

HERE = Path(__file__).parent
OPTIMISED = "-O2"
CONTROLLER = tuple(name for name in exported_package.SOURCES if name != "elastic_arm")
SAMPLES = 2  # of the recorded case, which is not used here


def c_program(scenario: Scenario, folder: Path) -> Path:
    """Export a scenario as C, compile it with the host replay.c and return the program."""
    write(export(loop_of(scenario), "fjr", SAMPLES), folder)
    sources = [*folder.glob("fjr*.c"), HERE / "replay.c"]
    return built([*C99, OPTIMISED], sources, folder / "replay", f"-I{folder}", f"-I{HERE}")


def controller_program(scenario: Scenario, folder: Path) -> Path:
    """Export a scenario for ros2_control, compile its controller with the host replay.cpp and return the program."""
    package = exported_package.package_name_of(scenario.name)
    exported_package.exported(scenario, folder, SAMPLES)
    return exported_package.linked(folder, package, CONTROLLER, HERE / "replay.cpp")


def program_efforts(program: Path, sequence: Sequence) -> Efforts:
    """Return all efforts (k, n) that a program sends."""
    inputs, changed = (program.with_name(name) for name in ("inputs", "changed"))
    inputs.write_bytes(sequence.table.tobytes())
    changed.write_bytes(_changed(sequence))
    numbers = map(str, (sequence.rounds, sequence.shift, int(sequence.simulated)))
    words = [str(program), str(inputs), *numbers, str(changed)]
    done = subprocess.run(words, stdout=subprocess.PIPE, timeout=HANG, check=True)
    return np.frombuffer(done.stdout).reshape(-1, len(sequence.scenario.joints))


def _changed(sequence: Sequence) -> bytes:
    """Return what a CHANGE sets, as replay.c reads it."""
    law = sequence.scenario.sampled_law
    library = step_library(law.robot.n, len(law.memory))
    settings, *numbers = changes(library, sequence)
    return b"".join([bytes(library.ffi.buffer(settings)), *(each.tobytes() for each in numbers)])
