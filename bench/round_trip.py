# SPDX-License-Identifier: Apache-2.0
"""Latency from state to effort: controller node against a bare node with the same messages."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.arm import Arm
from bench.figures import Figure
from bench.measure import ratio
from bench.nodes import bare, controller, driver, output, running, scenario_file
from fjr_core.config.scenario import Scenario

ROUNDS = 15
NATIVE, RCLPY, BARE = "native", "rclpy", "bare"
BOUNDS = {NATIVE: (0.75, 0.75), RCLPY: (1.25, 1.25)}
"""Of each host of the control step: median and 99th percentile over those of the bare node."""
PATIENCE = 10.0  # s; timeout of a side waiting for its turn
LONGEST = 60.0  # s; timeout of the start

Times = dict[str, list[list[float]]]
"""Latencies [us] of each round, by side."""


def over_echo(arm: Arm, rounds: int = ROUNDS) -> list[Figure]:
    """Compare median and 99th percentile of both hosts with the bare node, round by round; the arm is at rest."""
    with scenario_file(at_rest(arm.scenario)) as file:
        nodes = (
            controller(file, "-r", f"__ns:=/{NATIVE}", "-p", "executor:=native"),
            controller(file, "-r", f"__ns:=/{RCLPY}", "-p", "executor:=events"),
            bare("echo", "-r", f"__ns:=/{BARE}"),
        )
        times = latencies(arm, rounds, (NATIVE, RCLPY, BARE), nodes)
    return [figure for host in (NATIVE, RCLPY) for figure in _over_echo(host, times)]


def _over_echo(host: str, times: Times) -> list[Figure]:
    name, pair = f"state to effort over a bare echo, {host}", {side: times[side] for side in (host, BARE)}
    median, percentile = BOUNDS[host]
    return [figure(f"{name}, median", 50, median, pair), figure(f"{name}, 99th percentile", 99, percentile, pair)]


def at_rest(scenario: Scenario) -> dict[str, Any]:
    """Return the parameters with which the reference stands still."""
    offset = scenario.reference.jets(0.0)[0]
    zeros = [0.0] * len(offset)
    return {"reference.amplitude": zeros, "reference.offset": offset.tolist(), "state_timeout": PATIENCE}


def latencies(arm: Arm, rounds: int, sides: tuple[str, ...], nodes: Sequence[Sequence[str]]) -> Times:
    """Run the nodes of both sides (namespaces) with the driver, which sends the reference as state."""
    position = np.tile(arm.scenario.reference.jets(0.0)[0], 2).tolist()
    given = {"rounds": rounds, "sides": f"[{', '.join(sides)}]", "position": position}
    arguments = [part for name, value in given.items() for part in ("-p", f"{name}:={value}")]
    with running(*nodes):
        times: Times = json.loads(output(driver(*arguments), LONGEST + 4 * rounds))
    return times


def figure(name: str, percent: int, bound: float | None, times: Times) -> Figure:
    """Return the ratio of a percentile of both sides, with the median of each over the rounds."""
    ours, theirs = (np.array([np.percentile(each, percent) for each in rounds]) for rounds in times.values())
    parts = {f"{side} [us]": float(np.median(each)) for side, each in zip(times, (ours, theirs), strict=True)}
    return Figure(name, ratio(ours, theirs), "", bound=bound, parts=parts)
