# SPDX-License-Identifier: Apache-2.0
"""Cost of the certificate: latency from state to effort of the controller node with it and without it."""

from __future__ import annotations

from bench.arm import Arm
from bench.figures import Figure
from bench.nodes import controller, scenario_file
from bench.round_trip import ROUNDS, at_rest, figure, latencies

WITH, WITHOUT = "with", "without"
BOUND = 1.10


def with_and_without(arm: Arm, rounds: int = ROUNDS) -> list[Figure]:
    """Compare median and 99th percentile of both, round by round; the arm rests at its reference."""
    still = at_rest(arm.scenario)
    with scenario_file(still) as file, scenario_file({**still, "certificate": False}) as plain:
        nodes = (controller(file, "-r", f"__ns:=/{WITH}"), controller(plain, "-r", f"__ns:=/{WITHOUT}"))
        times = latencies(arm, rounds, (WITH, WITHOUT), nodes)
    name = "state to effort with certificate"
    return [figure(f"{name}, median", 50, BOUND, times), figure(f"{name}, 99th percentile", 99, None, times)]
