# SPDX-License-Identifier: Apache-2.0
"""The loop of `arm7` at 1 kHz: states answered before the next one, and processor time; rate in lock-step.

Answers count from the first effort on, of both hosts of the nodes in turns, with the certificate, quiet and beside busy
processes. Samples per second in lock-step are compared with two bare nodes that exchange states and commands.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.bare import PERIOD
from bench.figures import Figure
from bench.measure import ratio
from bench.nodes import HOSTS, bare, burning, controller, plant, running, scenario_file
from bench.tap import Seen, Tap
from fjr_msgs_py import names

SECONDS = 60.0
BUSY = 6
QUIET_BOUND, BUSY_BOUND = 99.9, 99.0  # % of the native host
PROCESSOR_BOUND = 12.0  # % of a core
MUJOCO_BOUNDS = 99.5, 35.0  # % of the states, % of a core
WARM_UP = 3.0  # s; not in the processor time
LONGEST = 60.0  # s; timeout of the start
REPEATS, COUNTED, SETTLING = 5, 5.0, 1.0  # in lock-step; s; s before it
RATE_BOUNDS = {"native": 1.3, "events": 0.7}  # of the rates of both hosts over that of the bare nodes


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
