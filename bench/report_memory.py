# SPDX-License-Identifier: Apache-2.0
"""Check that the memory of `fjr report` and of the verdict of `fjr run` does not grow with the run.

The bag of an hour is a short run of `arm7` in lock-step, of which two periods of the reference are repeated.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from mcap.records import Message

from bench.figures import Figure
from fjr_monitor.recording.bag import Bag, header_stamp, in_order, read_bag
from fjr_monitor.recording.recorder import BagWriter
from fjr_monitor.recording.topic import type_hash
from fjr_msgs_py import names

MINUTES = 60.0
RECORDED, BEGIN, END = 9.0, 4.0, 8.0  # s of stamped time: of the run; repeated from, to
BOUND = 600.0  # MB
STATES, REFERENCE = f"/{names.JOINT_STATES}", names.REFERENCE.replace("~", f"/{names.CONTROLLER}")
COMMANDS, EFFORTS = f"/{names.JOINT_COMMANDS}", f"/{names.EFFORT_COMMANDS}"
COPIED = (STATES, COMMANDS, REFERENCE, EFFORTS)  # what a report reads, and more than half of all messages
PEAK = (  # in a small process: a child's peak is at least that of the process that started it
    "import resource, subprocess, sys; code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode; "
    "print(code, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
)
VERDICT = "import sys; from pathlib import Path; from fjr_monitor.report.write import report_run as r; "
VERDICT += "r('arm7', Path(sys.argv[1]), None, pages=False)"


def bounded(minutes: float = MINUTES) -> list[Figure]:
    """Return the largest resident memory of verdict and report of a long run, with the time per recorded minute."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        _called([_fjr(), "run", "arm7", "--lockstep", "--no-report", f"--duration={RECORDED}", f"--output={folder}"])
        short, long = (folder / "arm7").resolve(), folder / "long"
        long.mkdir()
        shutil.copyfile(short / "scenario.yaml", long / "scenario.yaml")
        write_repeated(read_bag(short), long / "bag", minutes)
        commands = {"the verdict of fjr run": [sys.executable, "-c", VERDICT, str(long)]}
        commands["fjr report"] = [_fjr(), "report", str(long)]
        figures = []
        for name, command in commands.items():
            few, _ = _called([*command[:-1], str(short)])
            most, seconds = _called(command)
            parts = {f"{RECORDED:g} s [MB]": few, "minutes": minutes, "s per recorded minute": seconds / minutes}
            figures.append(Figure(f"memory of {name}, an hour at 1 kHz", most, "MB", bound=BOUND, parts=parts))
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


def _fjr() -> str:
    command = shutil.which("fjr")
    if command is None:
        raise RuntimeError("fjr is not on the path; expected a sourced workspace")
    return command


def _called(command: Sequence[str]) -> tuple[float, float]:
    """Return the largest resident memory [MB] of a command and the time that it took [s]."""
    start = time.monotonic()
    found = subprocess.run([sys.executable, "-c", PEAK, *command], stdout=subprocess.PIPE, text=True)
    code, peak = map(int, found.stdout.split())
    if code:
        raise RuntimeError(f"{' '.join(command)} ended with {code}; expected 0")
    return peak / 1024, time.monotonic() - start
