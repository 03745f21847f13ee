# SPDX-License-Identifier: Apache-2.0
"""The loop of `arm7` at 1 kHz: latency from state to effort, states answered before the next one, rate in lock-step.

Latencies are those of both hosts of the controller node against a bare node with the same messages, and with the
certificate against without: the effort leaves before the certificate is computed, whose cost is the delay of the
following cycle. Answers count from the first effort on, of both hosts in turns, with the certificate, quiet and beside
busy processes. Samples per second in lock-step are compared with two bare nodes that exchange states and commands.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.arm import arm7
from bench.bare import PERIOD
from bench.figures import Figure, ratio
from bench.nodes import HOSTS, PRIORITY, Seen, Tap, bare, burning, controller, plant, running, scenario_file, used
from fjr_core.config.scenario import Scenario
from fjr_msgs_py import names

ROUNDS = 15
NATIVE, RCLPY, BARE = "native", "rclpy", "bare"
WITH, WITHOUT = "with", "without"
BOUNDS = {NATIVE: (0.75, 0.75), RCLPY: (1.25, 1.25)}
"""Of each host of the control step: of the PERCENTILES over those of the bare node."""
PERCENTILES = {"median": 50, "99th percentile": 99}
WITH_BOUND = 1.10  # median with the certificate over that without it
PATIENCE = 10.0  # s; timeout of a side waiting for its turn
SECONDS = 60.0
BUSY = 6
QUIET_BOUND, BUSY_BOUND = 99.9, 99.0  # % of the native host
PROCESSOR_BOUND = 12.0  # % of a core
MUJOCO_BOUNDS = 99.5, 35.0  # % of the states, % of a core
WARM_UP = 3.0  # s; not in the processor time
LONGEST = 60.0  # s; timeout of the start
REPEATS, COUNTED, SETTLING = 5, 5.0, 1.0  # in lock-step; s; s before it
RATE_BOUNDS = {"native": 1.3, "events": 0.7}  # of the rates of both hosts over that of the bare nodes

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
    driver = (sys.executable, "-m", "bench.bare", "driver", "--ros-args", *arguments)
    with running(*nodes):
        times: Times = json.loads(used(*driver, longest=LONGEST + 4 * rounds).output)
    return times


def figure(name: str, percent: int, bound: float | None, times: Times) -> Figure:
    """Return the ratio of a percentile of both sides, with the median of each over the rounds."""
    ours, theirs = (np.array([np.percentile(each, percent) for each in rounds]) for rounds in times.values())
    parts = {f"{side} [us]": float(np.median(each)) for side, each in zip(times, (ours, theirs), strict=True)}
    return Figure(name, ratio(ours, theirs), "", bound=bound, parts=parts)


def answered(seconds: float = SECONDS) -> list[Figure]:
    """Return the share of states answered before the next one, and the processor time of the nodes."""
    found = {(host, busy): _run(host, busy, seconds) for busy in (0, BUSY) for host in HOSTS}
    figures = []
    for busy, bound in ((0, QUIET_BOUND), (BUSY, BUSY_BOUND)):
        native, rclpy = (found[host, busy][0] for host in HOSTS)
        name = f"answered before the next state, {busy} busy processes"
        figures.append(Figure(name, native, "%", bound=bound, at_least=True, parts={"rclpy [%]": rclpy}))
    for k, node in enumerate(("plant", "controller")):
        native, rclpy = (found[host, 0][1 + k] for host in HOSTS)
        name = f"processor time of the {node} at 1 kHz"
        figures.append(Figure(name, native, "% of a core", bound=PROCESSOR_BOUND, parts={"rclpy [%]": rclpy}))
    return figures


def on_mujoco(seconds: float = SECONDS) -> list[Figure]:
    """Return the share of states of a plant on MuJoCo answered before the next one, and its processor time."""
    share, used, _ = _run("native", 0, seconds, "-p", "engine:=mujoco")
    return [
        Figure("answered before the next state, plant on MuJoCo", share, "%", bound=MUJOCO_BOUNDS[0], at_least=True),
        Figure("processor time of the plant on MuJoCo", used, "% of a core", bound=MUJOCO_BOUNDS[1]),
    ]


def _run(host: str, busy: int, seconds: float, *simulator: str) -> tuple[float, float, float]:
    """Return the share of answered states [%] and the processor times of plant and controller [% of a core]."""
    executor = "-p", f"executor:={host}"
    with (
        scenario_file() as file,
        burning(busy),
        Tap() as tap,
        running(plant(file, *executor, *simulator), controller(file, *executor)) as pids,
        tap.listening([names.JOINT_STATES, names.JOINT_COMMANDS], LONGEST) as heard,
    ):
        heard.collect(WARM_UP)
        before = [processor_time(pid) for pid in pids]
        heard.collect(seconds)
        used = [100 * (processor_time(pid) - begin) / seconds for pid, begin in zip(pids, before, strict=True)]
        states, commands = heard.messages()
    return 100 * float(in_time(states[states[:, 0] >= commands[0, 0]], commands).mean()), used[0], used[1]


def in_time(states: NDArray[np.int64], commands: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which states but the last had their command sent before the next state; rows: stamp, send time [ns]."""
    sent = dict(commands[:, :2].tolist())
    pairs = zip(states[:-1, 0].tolist(), states[1:, 1].tolist(), strict=True)
    return np.array([sent.get(stamp, following) < following for stamp, following in pairs])


def processor_time(pid: int) -> float:
    """Return the processor time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def over_ping_pong(repeats: int = REPEATS, seconds: float = COUNTED) -> list[Figure]:
    """Compare the rates of both hosts in lock-step with the bare nodes, in turns; nodes are restarted."""
    with scenario_file() as file:
        pairs = {
            host: (
                plant(file, "-p", "lockstep:=true"),
                controller(file, "-p", "realtime_priority:=0", "-p", f"executor:={host}"),
            )
            for host in RATE_BOUNDS
        }
        pairs["bare"] = (bare("ping", priority=0), bare("pong", priority=0))
        rounds = [[_rate(commands, seconds) for commands in pairs.values()] for _ in range(repeats)]
    rates = dict(zip(pairs, np.array(rounds).T, strict=True))
    theirs, figures = rates.pop("bare"), []
    for host, ours in rates.items():
        parts = {f"{who} [samples/s]": float(np.median(each)) for who, each in (("ours", ours), ("bare", theirs))}
        parts["least"] = float(np.min(ours / theirs))
        name, bound = f"lock-step over a bare ping-pong, {host}", RATE_BOUNDS[host]
        figures.append(Figure(name, ratio(ours, theirs), "", bound=bound, at_least=True, parts=parts))
    return figures


def _rate(commands: Sequence[Sequence[str]], seconds: float) -> float:
    """Return samples per second, from the stamps of two states without a subscription between them."""
    with running(*commands), Tap() as tap:
        tap.next(names.JOINT_STATES, LONGEST)
        time.sleep(SETTLING)
        first = tap.next(names.JOINT_STATES, LONGEST)
        time.sleep(seconds)
        last = tap.next(names.JOINT_STATES, LONGEST)
    return samples_per_second(first, last)


def samples_per_second(first: Seen, last: Seen) -> float:
    """Return samples per second from stamps (one period per sample) and send times."""
    return (last.stamp - first.stamp) / PERIOD / ((last.sent - first.sent) * 1e-9)
