# SPDX-License-Identifier: Apache-2.0
"""Latency from state to effort: controller node against a bare node with the same messages."""

from __future__ import annotations

import json

import numpy as np

from bench.arm import Arm
from bench.figures import Figure
from bench.measure import ratio
from bench.nodes import bare, controller, driver, output, running, scenario_file
from fjr_core.numerics.checks import Array

ROUNDS = 15
OURS, BARE = "ours", "bare"
BOUND = 1.25
PATIENCE = 10.0  # s; timeout of a side waiting for its turn
LONGEST = 60.0  # s; timeout of the start


def over_echo(arm: Arm, rounds: int = ROUNDS) -> list[Figure]:
    """Compare median and 99th percentile of both, round by round; the arm rests at its reference."""
    n = arm.robot.n
    offset = arm.scenario.reference.jets(0.0)[0]
    still = {"reference.amplitude": [0.0] * n, "reference.offset": offset.tolist(), "state_timeout": PATIENCE}
    arguments = ["-p", f"rounds:={rounds}", "-p", f"sides:=[{OURS}, {BARE}]"]
    position = ["-p", f"position:={np.tile(offset, 2).tolist()}"]
    with scenario_file(still) as file:
        commands = (controller(file, "-r", f"__ns:=/{OURS}"), bare("echo", "-r", f"__ns:=/{BARE}"))
        with running(*commands):
            times = json.loads(output(driver(*arguments, *position), LONGEST + 4 * rounds))
    return [_figure("median", 50, times), _figure("99th percentile", 99, times)]


def _figure(name: str, percent: int, times: dict[str, list[list[float]]]) -> Figure:
    ours, theirs = (percentiles(times[side], percent) for side in (OURS, BARE))
    parts = {"ours [us]": float(np.median(ours)), "bare [us]": float(np.median(theirs))}
    return Figure(f"state to effort over a bare echo, {name}", ratio(ours, theirs), "", bound=BOUND, parts=parts)


def percentiles(rounds: list[list[float]], percent: int) -> Array:
    """Return a percentile [us] of each round."""
    return np.array([np.percentile(times, percent) for times in rounds])
