# SPDX-License-Identifier: Apache-2.0
"""Check that the memory of both nodes is constant while they run in real time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench.figures import Figure
from bench.nodes import controller, plant, running, scenario_file
from bench.tap import Tap
from fjr_core.numerics.checks import Array
from fjr_msgs_py import names

HOSTS = ("native", "events")
"""Values of the parameter `executor` of both nodes."""
MINUTES = 10.0
SETTLED = 1.0  # minutes; discarded
BOUND = 16.0  # kB/min; a quarter of a byte a sample at 1 kHz
PERIOD = 1.0  # s
LONGEST = 60.0  # s; timeout of the start


def flat(minutes: float = MINUTES) -> list[Figure]:
    """Return the growth of the resident memory of each node, by a line fit after the first minute.

    For the hosts of the control step one after the other, with minutes each.
    """
    return [each for host in HOSTS for each in _of_host(host, minutes)]


def _of_host(host: str, minutes: float) -> list[Figure]:
    executor = "-p", f"executor:={host}"
    with scenario_file() as file, running(plant(file, *executor), controller(file, *executor)) as pids:
        with Tap() as tap:
            tap.next(names.JOINT_COMMANDS, LONGEST)
        seconds, kilobytes = _watched(pids, 60 * minutes)
    nodes = (f"plant node, {host}", f"controller node, {host}")
    return [figure(name, seconds, column) for name, column in zip(nodes, kilobytes.T, strict=True)]


def _watched(pids: Sequence[int], duration: float) -> tuple[Array, Array]:
    """Return times (k,) [s] and resident memory (k, processes) [kB]."""
    start, rows = time.monotonic(), []
    while (now := time.monotonic() - start) < duration:
        rows.append([now, *(resident(pid) for pid in pids)])
        time.sleep(PERIOD)
    table = np.array(rows)
    return table[:, 0], table[:, 1:]


def resident(pid: int) -> float:
    """Return the resident memory of a process [kB]; raise RuntimeError if it has ended."""
    try:
        text = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        raise RuntimeError(f"process {pid} has ended; expected it to be running") from None
    return float(next(line for line in text.splitlines() if line.startswith("Rss:")).split()[1])


def figure(name: str, seconds: Array, kilobytes: Array) -> Figure:
    """Fit a line to the resident memory (k,) [kB] over times (k,) [s], without the first minute; return its slope."""
    late = seconds >= min(60 * SETTLED, seconds[-1] / 2)
    slope = 60 * float(np.polyfit(seconds[late], kilobytes[late], 1)[0])
    parts = {
        "after 1 min [MB]": float(kilobytes[late][0]) / 1024,
        "at the end [MB]": float(kilobytes[-1]) / 1024,
        "minutes": float(seconds[-1]) / 60,
    }
    return Figure(f"memory of the {name}, growth", slope, "kB/min", bound=BOUND, parts=parts)
