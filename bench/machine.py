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

from bench.arm import ROOT
from fjr_msgs_py.node.scheduling import prioritised

COMMAND = (sys.executable, "-m", "bench.machine")
PERIOD, PRIORITY = 1e-3, 80  # s; SCHED_FIFO, if it is granted


@contextmanager
def watched() -> Iterator[list[float]]:
    """Yield a list that holds, after the block, how late [ms] each wake-up in it was, on any core."""
    late: list[float] = []
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
                late += map(float, sleeper.communicate()[0].split())


def main() -> int:
    """Sleep again and again on a core until SIGTERM, then print the lateness of each wake-up [ms]."""
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
            late.append(1e3 * (time.monotonic() - due))
    print(*late)
    return 0


if __name__ == "__main__":
    sys.exit(main())
