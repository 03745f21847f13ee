# SPDX-License-Identifier: Apache-2.0
"""Compile exported C and C++ with warnings as errors, run the programs and read their output."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from fjr_core.config.scenario import Scenario, load_scenario
from fjr_design.exports.c_code import prefix_of
from fjr_design.exports.project import export, write
from fjr_msgs_py.scenarios import library
from program_cache import built
from time_limits import HANG

SCENARIOS = Path(__file__).parents[3] / "ros2_ws" / "src" / "fjr_bringup" / "scenarios"
SHIPPED = sorted(path.stem for path in SCENARIOS.glob("*.yaml"))
STRICT = ("-O1", "-Wall", "-Wextra", "-pedantic", "-Werror", "-ffp-contract=off")
C99, CPP = ("cc", "-std=c99", *STRICT), ("c++", "-std=c++17", *STRICT)


@cache
def scenario(name: str) -> Scenario:
    """Return a shipped scenario."""
    return load_scenario(SCENARIOS / f"{name}.yaml")


def changed(name: str, values: Mapping[str, object]) -> Scenario:
    """Return a shipped scenario with other parameters."""
    return library.as_run(SCENARIOS / f"{name}.yaml", values)[1]


def exported(scenario: Scenario, folder: Path, samples: int = 100, prefix: str | None = None) -> Path:
    """Export a scenario to a folder and return the folder."""
    write(export(scenario, prefix or prefix_of(scenario.name), samples), folder)
    return folder


def program_output(program: Path, *arguments: str, code: int = 0) -> str:
    """Return the output of a program that must end with this exit code."""
    done = subprocess.run([str(program), *arguments], capture_output=True, text=True, timeout=HANG)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def replayed(folder: Path) -> Mapping[str, float]:
    """Run the replay program of the folder; return the numbers that it compares, by what they are."""
    return compared(built(C99, sorted(folder.glob("*.c")), folder / "replay"), folder / "case.txt")


def compared(program: Path, case: Path, code: int = 0) -> Mapping[str, float]:
    """Replay a case file; return the numbers that the program compares, by what they are."""
    lines = program_output(program, str(case), code=code).splitlines()
    found = (re.match(r"  (\w.*?)  +(\S+)  \(", line) for line in lines)
    return {row[1]: float(row[2]) for row in found if row}
