# SPDX-License-Identifier: Apache-2.0
"""Check that memory is bounded: of both nodes in real time, of `fjr sweep` with many runs, of reports of long runs.

The long run is an hour of `arm7` in lock-step, which takes a quarter of an hour.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench.figures import Figure
from bench.nodes import HOSTS, Tap, controller, plant, running, scenario_file, used
from fjr_core.numerics.checks import Array
from fjr_msgs_py import names

MINUTES = 10.0
SETTLED = 1.0  # minutes; discarded
BOUND = 16.0  # kB/min; a quarter of a byte a sample at 1 kHz
PERIOD = 1.0  # s
LONGEST = 60.0  # s; timeout of the start
MANY, FEW = 1_000_000, 10_000  # runs of the sweep
SWEEP = """
scenario: paper_k31
runs: {runs}
duration: 0.02
settle_after: 0.01
vary:
  stiffness: {{uniform: [0.7, 1.3]}}
  link_inertia: {{uniform: [0.8, 1.2]}}
  delay: {{uniform: [0.0, 1.0e-3]}}
"""
HOUR, SHORT = 60.0, 9.0  # minutes of the long run; s of the short one
REPORT_BOUND = 600.0  # MB
VERDICT = "import sys; from pathlib import Path; from fjr_monitor.report.write import report_run as r; "
VERDICT += "r('arm7', Path(sys.argv[1]), None, pages=False)"


def of_nodes(minutes: float = MINUTES) -> list[Figure]:
    """Return the growth of the resident memory of each node, by a line fit after the first minute.

    For the hosts of the control step one after the other, with minutes each.
    """
    figures = []
    for host in HOSTS:
        executor = "-p", f"executor:={host}"
        with scenario_file() as file, running(plant(file, *executor), controller(file, *executor)) as pids:
            with Tap() as tap:
                tap.next(names.JOINT_COMMANDS, LONGEST)
            seconds, kilobytes = _watched(pids, 60 * minutes)
        sides = zip(("plant", "controller"), kilobytes.T, strict=True)
        figures += [figure(f"{side} node, {host}", seconds, column) for side, column in sides]
    return figures


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


def of_sweep(many: int = MANY) -> list[Figure]:
    """Compare the peak resident memory of a study of many short runs with that of few, table and figure included."""
    with tempfile.TemporaryDirectory() as folder:
        peaks = []
        for runs in (FEW, many):
            file = Path(folder, f"{runs}.yaml")
            file.write_text(SWEEP.format(runs=runs), encoding="utf-8")
            peaks.append(used("fjr", "sweep", str(file), "--output", str(file.with_suffix(""))).memory)
    few, most = peaks
    parts = {f"{FEW:,} runs [MB]": few, f"{many:,} runs [MB]": most}
    return [Figure("memory of fjr sweep, many runs over few", most / few, "", bound=2.0, aim=1.5, parts=parts)]


def of_reports(minutes: float = HOUR) -> list[Figure]:
    """Return the largest resident memory of verdict and report of a long run, with the time per recorded minute."""
    with tempfile.TemporaryDirectory(prefix="fjr-bench-") as place:
        runs = {seconds: Path(place, f"{seconds:g}") for seconds in (SHORT, 60 * minutes)}
        for seconds, folder in runs.items():
            used("fjr", "run", "arm7", "--lockstep", "--no-report", f"--duration={seconds}", f"--output={folder}")
        figures = []
        verdict = sys.executable, "-c", VERDICT
        for name, command in {"the verdict of fjr run": verdict, "fjr report": ("fjr", "report")}.items():
            few, most = (used(*command, str((folder / "arm7").resolve())) for folder in runs.values())
            parts = {f"{SHORT:g} s [MB]": few.memory, "minutes": minutes}
            parts["s per recorded minute"] = most.seconds / minutes
            name = f"memory of {name}, an hour at 1 kHz"
            figures.append(Figure(name, most.memory, "MB", bound=REPORT_BOUND, parts=parts))
        return figures
