# SPDX-License-Identifier: Apache-2.0
"""Exports as programs: C and C++ compiled with every warning an error, run, their output read."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from fjr_core.codegen import Loop, export, loop_of, prefix_of, write
from fjr_core.config.scenario import load_scenario
from patience import HANG

SCENARIOS = Path(__file__).parents[3] / "ros2_ws" / "src" / "fjr_bringup" / "scenarios"
SHIPPED = sorted(path.stem for path in SCENARIOS.glob("*.yaml"))
STRICT = ("-O1", "-Wall", "-Wextra", "-pedantic", "-Werror", "-ffp-contract=off")
C99, CPP = ("cc", "-std=c99", *STRICT), ("c++", "-std=c++17", *STRICT)


@cache
def loop(name: str) -> Loop:
    """The loop of a shipped scenario."""
    return loop_of(load_scenario(SCENARIOS / f"{name}.yaml"))


def changed(scenario: str, **fields: object) -> Loop:
    """The loop of a shipped scenario with another law, reference, plant, ..."""
    return replace(loop(scenario), **fields)


def exported(loop: Loop, folder: Path, samples: int = 100, prefix: str | None = None) -> Path:
    """The folder with the export of a loop."""
    write(export(loop, prefix or prefix_of(loop.name), samples), folder)
    return folder


def built(command: Sequence[str], sources: Sequence[Path], program: Path, *options: str) -> Path:
    """A program or object of the sources; fails on the first warning."""
    done = subprocess.run(
        [*command, *options, *map(str, sources), "-o", str(program), "-lm"],
        capture_output=True,
        text=True,
        timeout=HANG,
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return program


def said(program: Path, *arguments: str, code: int = 0) -> str:
    """What a program says that ends with this code."""
    done = subprocess.run([str(program), *arguments], capture_output=True, text=True, timeout=HANG)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def replayed(folder: Path, code: int = 0) -> Mapping[str, float]:
    """Worst differences that the folder's own replay tells, by what differs."""
    program = built(C99, sorted(folder.glob("*.c")), folder / "replay")
    lines = said(program, str(folder / "case.csv"), code=code).splitlines()
    found = (re.match(r"  (\w.*?)  +(\S+)  \(", line) for line in lines)
    return {row[1]: float(row[2]) for row in found if row}
