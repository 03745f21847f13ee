# SPDX-License-Identifier: Apache-2.0
"""Move public robots and the example of the paper by each engine of the plant; write docs/tables/engines.md.

make engines                                                  # 15 minutes
PYTHONPATH=tools .venv/bin/python -m engine_survey Panda      # only scenarios with this in their name

The nodes in lock-step move to the same bits (tests/engines/test_engines.py). Results are kept in runs/survey, so
that a second call goes on.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.figures import kept, markdown, put
from diagnosis_benchmark.lock_step import LockStepLoop
from fjr_core.config.plant import ENGINES, OWN
from fjr_core.numerics.checks import Array
from fjr_msgs_py.scenarios import library
from robot_survey import FOLDER, ROBOTS, PublicRobot

SHIPPED = ("paper_k31", "paper_k3p1", "two_link", "arm7")
SCENARIOS: Mapping[str, PublicRobot | None] = {**dict.fromkeys(SHIPPED), **{robot.name: robot for robot in ROBOTS}}
KINDS = (OWN, *ENGINES)
PAIRS = {f"{one} - {other}": (one, other) for one, other in combinations(KINDS, 2)}
DURATION, SETTLED = 5.0, 2.0  # s
LARGEST = 1e-6  # rad, m: difference of two engines with the same motion
MOST_STEPS = 64
HEADINGS = ("scenario", "joints", "inner steps", *PAIRS, "half the step", "after 2 s", "peak effort")


class Motion(NamedTuple):
    """Positions (s, 2n) of links and motors [rad], tracking error after SETTLED [rad], largest effort [N m]."""

    positions: Array
    error: float
    effort: float


def motion(scenario: str, engine: str, inner_steps: int, duration: float) -> Motion:
    """Move a scenario, by name or path, in the loop that both nodes form in lock-step."""
    given = {"engine": engine, "inner_steps": inner_steps, "lockstep": "true", "compile": "false"}
    loop = LockStepLoop(library.load(scenario, [f"{name}:={value}" for name, value in given.items()])).run(duration)
    positions = np.array([position for _, (_, position, _, _) in loop.states])
    _, efforts, jets = map(np.array, zip(*loop.commands, strict=True))
    late = np.abs(positions[:, : efforts.shape[1]] - jets[:, 0])[round(SETTLED / loop.scenario.sample_period) :]
    return Motion(positions, float(np.max(late, initial=0.0)), float(np.max(np.abs(efforts))))


def differences(motions: Mapping[str, Motion]) -> dict[str, float]:
    """Return the largest difference of a joint between each pair of engines [rad]."""
    return {
        pair: float(np.max(np.abs(motions[one].positions - motions[other].positions)))
        for pair, (one, other) in PAIRS.items()
    }


def compared(scenario: str, duration: float = DURATION) -> dict[str, Any]:
    """Compare the engines with as many inner steps as they need to agree, and with twice as many."""
    inner_steps = library.load(scenario).inner_steps
    motions = {engine: motion(scenario, engine, inner_steps, duration) for engine in KINDS}
    while True:
        finer = {engine: motion(scenario, engine, 2 * inner_steps, duration) for engine in KINDS}
        found = differences(motions)
        if max(found.values()) <= LARGEST or inner_steps >= MOST_STEPS:
            break
        motions, inner_steps = finer, 2 * inner_steps
    return {
        "joints": motions[OWN].positions.shape[1] // 2,
        "inner steps": inner_steps,
        "differences": list(found.values()),
        "finer": list(differences(finer).values()),
        "errors": [each.error for each in motions.values()],
        "efforts": [each.effort for each in motions.values()],
    }


def results(name: str) -> Path:
    """Return the file that keeps the result of a scenario."""
    robot = SCENARIOS[name]
    return (robot.scenario if robot else FOLDER / name).with_suffix(".engines.json")


def outcome(name: str) -> dict[str, Any]:
    """Compare the engines in a scenario, or read the kept result; {} for a robot that `fjr new` refuses."""
    robot = SCENARIOS[name]
    if robot and not results(name).exists() and not robot.scenario.exists() and robot.new()[1]:
        return {}
    found: dict[str, Any] = kept(results(name), lambda: compared(str(robot.scenario) if robot else name))
    return found


def row(name: str, found: Mapping[str, Any]) -> list[str]:
    """Return the cells of a scenario."""
    finer = ", ".join(f"{each:.0e}" for each in found["finer"])
    errors, efforts = {f"{each:.1e}" for each in found["errors"]}, {f"{each:.3f}" for each in found["efforts"]}
    numbers = [f"{each:.1e}" for each in found["differences"]]
    return [name, *(str(found[each]) for each in HEADINGS[1:3]), *numbers, finer, *map(", ".join, (errors, efforts))]


def table(outcomes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the Markdown lines: in how many scenarios all engines move alike, then a row for each."""
    equal = sum(max(found["differences"]) <= LARGEST for found in outcomes.values())
    said = f"In {equal} of {len(outcomes)} scenarios no joint differs by more than {LARGEST:g} rad (m) between engines."
    return [said, "", *markdown(HEADINGS, [row(name, found) for name, found in outcomes.items()])]


def main(names: Sequence[str]) -> int:
    """Compare the engines in the scenarios whose names contain one of these, all for none; write all kept results."""
    for name in SCENARIOS:
        if not names or any(each.lower() in name.lower() for each in names):
            found = outcome(name)
            print(*(row(name, found) if found else (name, "refused by `fjr new`")), sep=" | ", flush=True)
    put("engines.md", "engines", table({name: outcome(name) for name in SCENARIOS if results(name).exists()}))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
