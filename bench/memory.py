# SPDX-License-Identifier: Apache-2.0
"""Check that memory is bounded: of both nodes in real time, of `fjr sweep` with many runs, of reports of long runs.

The bag of an hour is a short run of `arm7` in lock-step, of which two periods of the reference are repeated.
"""

from __future__ import annotations

import shutil
import struct
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mcap.records import Message

from bench.figures import Figure
from bench.nodes import controller, plant, running, scenario_file, used
from bench.tap import Tap
from fjr_core.numerics.checks import Array
from fjr_monitor.recording.bag import Bag, header_stamp, in_order, read_bag
from fjr_monitor.recording.recorder import BagWriter
from fjr_monitor.recording.topic import type_hash
from fjr_msgs_py import names

HOSTS = ("native", "events")
"""Values of the parameter `executor` of both nodes."""
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
HOUR = 60.0  # minutes of the bag
RECORDED, BEGIN, END = 9.0, 4.0, 8.0  # s of stamped time: of the run; repeated from, to
REPORT_BOUND = 600.0  # MB
STATES, REFERENCE = f"/{names.JOINT_STATES}", names.REFERENCE.replace("~", f"/{names.CONTROLLER}")
COMMANDS, EFFORTS = f"/{names.JOINT_COMMANDS}", f"/{names.EFFORT_COMMANDS}"
COPIED = (STATES, COMMANDS, REFERENCE, EFFORTS)  # what a report reads, and more than half of all messages
VERDICT = "import sys; from pathlib import Path; from fjr_monitor.report.write import report_run as r; "
VERDICT += "r('arm7', Path(sys.argv[1]), None, pages=False)"


def of_nodes(minutes: float = MINUTES) -> list[Figure]:
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
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        used("fjr", "run", "arm7", "--lockstep", "--no-report", f"--duration={RECORDED}", f"--output={folder}")
        short, long = (folder / "arm7").resolve(), folder / "long"
        long.mkdir()
        shutil.copyfile(short / "scenario.yaml", long / "scenario.yaml")
        write_repeated(read_bag(short), long / "bag", minutes)
        figures = []
        verdict = sys.executable, "-c", VERDICT
        for name, command in {"the verdict of fjr run": verdict, "fjr report": ("fjr", "report")}.items():
            few, most = used(*command, str(short)), used(*command, str(long))
            parts = {f"{RECORDED:g} s [MB]": few.memory, "minutes": minutes}
            parts["s per recorded minute"] = most.seconds / minutes
            name = f"memory of {name}, an hour at 1 kHz"
            figures.append(Figure(name, most.memory, "MB", bound=REPORT_BOUND, parts=parts))
        return figures


def write_repeated(bag: Bag, folder: Path, minutes: float) -> None:
    """Write a bag of so many minutes: the run from its start to END, then again and again from BEGIN to END."""
    messages = list(in_order(bag.path, COPIED))
    start = header_stamp(next(message.data for name, message in messages if name == COMMANDS))
    sent = {header_stamp(message.data) - start: message.publish_time for name, message in messages if name == STATES}
    begin, end = (round(t * 1e9) for t in (BEGIN, END))
    first = [each for each in messages if each[1].publish_time < sent[end]]
    again = [each for each in first if each[1].publish_time >= sent[begin]]
    writer = BagWriter(folder)
    channels = {
        name: writer.add_topic(name, bag.topics[name].type_name, [names.LATEST], type_hash(bag.topics[name].type_name))
        for name in COPIED
    }
    for count in range(1 + round((minutes * 60 - END) / (END - BEGIN))):
        later, stamp = count * (sent[end] - sent[begin]), count * (end - begin)
        for name, message in again if count else first:
            channel = channels[name]
            data = message.data if name == EFFORTS else _shifted(message, stamp)
            writer.write(channel, message.log_time + later, message.publish_time + later, channel.count + 1, data)
    writer.close()


def _shifted(message: Message, later: int) -> bytes:
    """Return a little-endian message that starts with a header, its stamp `later` [ns]."""
    stamp = divmod(header_stamp(message.data) + later, 10**9)
    return message.data[:4] + struct.pack("<iI", *stamp) + message.data[12:]
