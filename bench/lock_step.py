# SPDX-License-Identifier: Apache-2.0
"""Samples per second in lock-step, against two bare nodes that exchange states and commands."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from bench.bare import PERIOD
from bench.figures import Figure
from bench.measure import ratio
from bench.nodes import bare, controller, plant, running, scenario_file
from bench.tap import Seen, Tap
from fjr_core.numerics.checks import Array
from fjr_msgs_py import names

REPEATS = 5
SECONDS = 5.0
BOUNDS = {"native": 1.3, "events": 0.7}
"""By the parameter `executor` of the controller."""
WARM_UP = 1.0  # s
LONGEST = 60.0  # s; timeout of the start


def over_ping_pong(repeats: int = REPEATS, seconds: float = SECONDS) -> list[Figure]:
    """Compare the rates of both hosts of the control step with the bare nodes, in turns; nodes are restarted."""
    with scenario_file() as file:
        pairs = {
            host: (
                plant(file, "-p", "lockstep:=true"),
                controller(file, "-p", "realtime_priority:=0", "-p", f"executor:={host}"),
            )
            for host in BOUNDS
        }
        pairs["bare"] = (bare("ping", priority=0), bare("pong", priority=0))
        rounds = [[_rate(commands, seconds) for commands in pairs.values()] for _ in range(repeats)]
    rates = dict(zip(pairs, np.array(rounds).T, strict=True))
    return [_figure(host, rates[host], rates["bare"]) for host in BOUNDS]


def _figure(host: str, ours: Array, theirs: Array) -> Figure:
    parts = {
        "ours [samples/s]": float(np.median(ours)),
        "bare [samples/s]": float(np.median(theirs)),
        "least": float(np.min(ours / theirs)),
    }
    name = f"lock-step over a bare ping-pong, {host}"
    return Figure(name, ratio(ours, theirs), "", bound=BOUNDS[host], at_least=True, parts=parts)


def _rate(commands: Sequence[Sequence[str]], seconds: float) -> float:
    """Return samples per second, from the stamps of two states without a subscription between them."""
    with running(*commands), Tap() as tap:
        tap.next(names.JOINT_STATES, LONGEST)
        time.sleep(WARM_UP)
        first = tap.next(names.JOINT_STATES, LONGEST)
        time.sleep(seconds)
        last = tap.next(names.JOINT_STATES, LONGEST)
    return samples_per_second(first, last)


def samples_per_second(first: Seen, last: Seen) -> float:
    """Return samples per second from stamps (one period per sample) and send times."""
    return (last.stamp - first.stamp) / PERIOD / ((last.sent - first.sent) * 1e-9)
