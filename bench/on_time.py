# SPDX-License-Identifier: Apache-2.0
"""The loop of `arm7` at 1 kHz beside other programs: states answered before the next one, and processor time.

Both hosts of the nodes are measured in turns, with the certificate, quiet and beside busy processes.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.figures import Figure
from bench.nodes import controller, plant, running, scenario_file
from bench.tap import Tap
from fjr_msgs_py import names

SECONDS = 60.0
BUSY = 6
HOSTS = ("native", "events")
QUIET_BOUND, BUSY_BOUND = 99.9, 99.0  # % of the native host
PROCESSOR_BOUND = 12.0  # % of a core
WARM_UP, LONGEST = 3.0, 60.0  # s


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


def _run(host: str, busy: int, seconds: float) -> tuple[float, float, float]:
    """Return the share of answered states [%] and the processor times of plant and controller [% of a core]."""
    topics = [names.JOINT_STATES, names.JOINT_COMMANDS]
    with ExitStack() as stack:
        file = stack.enter_context(scenario_file())
        executor = "-p", f"executor:={host}"
        pids = stack.enter_context(running(plant(file, *executor), controller(file, *executor)))
        tap, _ = stack.enter_context(Tap()), stack.enter_context(_burning(busy))
        tap.sent(topics, WARM_UP, LONGEST)
        before = [processor_time(pid) for pid in pids]
        states, commands = tap.messages(topics, seconds, LONGEST)
        used = [100 * (processor_time(pid) - time) / seconds for pid, time in zip(pids, before, strict=True)]
    return in_time(states, commands), used[0], used[1]


def in_time(states: NDArray[np.int64], commands: NDArray[np.int64]) -> float:
    """Return the share [%] of states whose command was sent before the next state; (k, 2): stamps and send times."""
    sent = dict(commands.tolist())
    pairs = zip(states[:-1, 0].tolist(), states[1:, 1].tolist(), strict=True)
    return 100 * float(np.mean([sent.get(stamp, following) < following for stamp, following in pairs]))


def processor_time(pid: int) -> float:
    """Return the processor time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _burning(count: int) -> Iterator[None]:
    """Keep the cores busy with ordinary processes inside the block."""
    with ExitStack() as stack:
        for _ in range(count):
            process = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(process.kill)
        yield
