# SPDX-License-Identifier: Apache-2.0
"""Latency from state to effort: controller node against a bare node with the same messages, and with its certificate.

The effort leaves before the certificate is computed: its cost is the delay of the following cycle.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.arm import arm7
from bench.figures import Figure
from bench.measure import ratio
from bench.nodes import PRIORITY, bare, controller, running, scenario_file, used
from fjr_core.config.scenario import Scenario

ROUNDS = 15
NATIVE, RCLPY, BARE = "native", "rclpy", "bare"
WITH, WITHOUT = "with", "without"
BOUNDS = {NATIVE: (0.75, 0.75), RCLPY: (1.25, 1.25)}
"""Of each host of the control step: of the PERCENTILES over those of the bare node."""
PERCENTILES = {"median": 50, "99th percentile": 99}
WITH_BOUND = 1.10  # median with the certificate over that without it
PATIENCE = 10.0  # s; timeout of a side waiting for its turn
LONGEST = 60.0  # s; timeout of the start

Times = dict[str, list[list[float]]]
"""Latencies [us] of each round, by side."""


def over_echo(rounds: int = ROUNDS) -> list[Figure]:
    """Compare median and 99th percentile of both hosts with the bare node, round by round; the arm is at rest."""
    with scenario_file(at_rest(arm7())) as file:
        nodes = (
            controller(file, "-r", f"__ns:=/{NATIVE}", "-p", "executor:=native"),
            controller(file, "-r", f"__ns:=/{RCLPY}", "-p", "executor:=events"),
            bare("echo", "-r", f"__ns:=/{BARE}"),
        )
        times = latencies(rounds, (NATIVE, RCLPY, BARE), nodes)
    return [
        figure(f"state to effort over a bare echo, {host}, {name}", percent, bound, {s: times[s] for s in (host, BARE)})
        for host, bounds in BOUNDS.items()
        for (name, percent), bound in zip(PERCENTILES.items(), bounds, strict=True)
    ]


def with_certificate(rounds: int = ROUNDS) -> list[Figure]:
    """Compare a controller with and without the certificate, round by round; the arm rests at its reference."""
    still = at_rest(arm7())
    with scenario_file(still) as file, scenario_file({**still, "certificate": False}) as plain:
        nodes = (controller(file, "-r", f"__ns:=/{WITH}"), controller(plain, "-r", f"__ns:=/{WITHOUT}"))
        times = latencies(rounds, (WITH, WITHOUT), nodes)
    bounds = zip(PERCENTILES.items(), (WITH_BOUND, None), strict=True)
    return [figure(f"state to effort with certificate, {name}", p, bound, times) for (name, p), bound in bounds]


def at_rest(scenario: Scenario) -> dict[str, Any]:
    """Return the parameters with which the reference stands still."""
    offset = scenario.reference.jets(0.0)[0]
    zeros = [0.0] * len(offset)
    return {"reference.amplitude": zeros, "reference.offset": offset.tolist(), "state_timeout": PATIENCE}


def latencies(rounds: int, sides: tuple[str, ...], nodes: Sequence[Sequence[str]]) -> Times:
    """Run the nodes of both sides (namespaces) with the driver, which sends the reference as state."""
    position = np.tile(arm7().reference.jets(0.0)[0], 2).tolist()
    given = {"rounds": rounds, "sides": f"[{', '.join(sides)}]", "position": position, "realtime_priority": PRIORITY}
    arguments = [part for name, value in given.items() for part in ("-p", f"{name}:={value}")]
    driver = (sys.executable, "-m", "bench.driver", "--ros-args", *arguments)
    with running(*nodes):
        times: Times = json.loads(used(*driver, longest=LONGEST + 4 * rounds).output)
    return times


def figure(name: str, percent: int, bound: float | None, times: Times) -> Figure:
    """Return the ratio of a percentile of both sides, with the median of each over the rounds."""
    ours, theirs = (np.array([np.percentile(each, percent) for each in rounds]) for rounds in times.values())
    parts = {f"{side} [us]": float(np.median(each)) for side, each in zip(times, (ours, theirs), strict=True)}
    return Figure(name, ratio(ours, theirs), "", bound=bound, parts=parts)
