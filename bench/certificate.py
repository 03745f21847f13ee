# SPDX-License-Identifier: Apache-2.0
"""Cost of the certificate: latency from state to effort of the controller node with it and without it."""

from __future__ import annotations

import json

import numpy as np

from bench.arm import Arm
from bench.figures import Figure
from bench.measure import ratio
from bench.nodes import controller, driver, output, running, scenario_file
from bench.round_trip import LONGEST, PATIENCE, ROUNDS, percentiles

WITH, WITHOUT = "certified", "plain"
BOUND = 1.10


def with_and_without(arm: Arm, rounds: int = ROUNDS) -> list[Figure]:
    """Compare median and 99th percentile of both, round by round; the arm rests at its reference."""
    n = arm.robot.n
    offset = arm.scenario.reference.jets(0.0)[0]
    still = {"reference.amplitude": [0.0] * n, "reference.offset": offset.tolist(), "state_timeout": PATIENCE}
    arguments = ["-p", f"rounds:={rounds}", "-p", f"sides:=[{WITH}, {WITHOUT}]"]
    position = ["-p", f"position:={np.tile(offset, 2).tolist()}"]
    with scenario_file(still) as file, scenario_file({**still, "certificate": False}) as plain:
        commands = (controller(file, "-r", f"__ns:=/{WITH}"), controller(plain, "-r", f"__ns:=/{WITHOUT}"))
        with running(*commands):
            times = json.loads(output(driver(*arguments, *position), LONGEST + 4 * rounds))
    return [_figure("median", 50, BOUND, times), _figure("99th percentile", 99, None, times)]


def _figure(name: str, percent: int, bound: float | None, times: dict[str, list[list[float]]]) -> Figure:
    ours, plain = (percentiles(times[side], percent) for side in (WITH, WITHOUT))
    parts = {"with [us]": float(np.median(ours)), "without [us]": float(np.median(plain))}
    return Figure(f"state to effort with certificate, {name}", ratio(ours, plain), "", bound=bound, parts=parts)
