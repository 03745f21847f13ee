# SPDX-License-Identifier: Apache-2.0
"""How late this machine itself wakes a thread that only sleeps, above the priority of all nodes: no loop is earlier."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

from bench.figures import ROOT
from fjr_msgs_py.node.scheduling import prioritised

COMMAND = (sys.executable, "-m", "bench.machine")
PERIOD, PRIORITY = 1e-3, 80  # s; SCHED_FIFO, if it is granted


class WakeUp(NamedTuple):
    """late: of a sleeper [ms]; at: when it woke, as the stamps of messages [ns]."""

    late: float
    at: int


@contextmanager
def watched() -> Iterator[list[WakeUp]]:
    """Yield a list that holds, after the block, each wake-up in it, on any core."""
    late: list[WakeUp] = []
    with ExitStack() as stack:
        sleepers = [
            stack.enter_context(subprocess.Popen([*COMMAND, str(core)], cwd=ROOT, stdout=subprocess.PIPE, text=True))
            for core in sorted(os.sched_getaffinity(0))
        ]
        for sleeper in sleepers:
            assert sleeper.stdout is not None
            sleeper.stdout.readline()  # it has begun
        try:
            yield late
        finally:
            for sleeper in sleepers:
                sleeper.terminate()
            for sleeper in sleepers:
                rows = map(str.split, sleeper.communicate()[0].splitlines())
                late += [WakeUp(float(each), int(at)) for each, at in rows]


def main() -> int:
    """Sleep again and again on a core until SIGTERM, then print each wake-up."""
    os.sched_setaffinity(0, {int(sys.argv[1])})
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
    late = []
    with prioritised(PRIORITY):
        print(flush=True)
        due = time.monotonic()
        while not stopped:
            due = max(due + PERIOD, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
            late.append((1e3 * (time.monotonic() - due), time.time_ns()))
    print(*(f"{each} {at}" for each, at in late), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
