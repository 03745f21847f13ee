# SPDX-License-Identifier: Apache-2.0
"""How a command ends: its exit code, and an orderly shutdown on signals."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from queue import SimpleQueue

from ..node.loading import SIGNALS, on_signals


class Exit(IntEnum):
    """Exit code of `fjr`. Of several runs in one command the first counts of FAILED, VIOLATED, LATE."""

    DONE = 0
    FAILED = 1
    NOT_UNDERSTOOD = 2
    VIOLATED = 3
    LATE = 4
    INTERRUPTED = 130  # 128 + SIGINT, the convention of shells


MEANINGS = {
    Exit.DONE: "done; of a run: finished, with a status other than those below",
    Exit.FAILED: "failed: an error, or the controller stopped during the run",
    Exit.NOT_UNDERSTOOD: "the command line, the scenario or another file is not valid",
    Exit.VIOLATED: "the run finished, and its status is `violated`",
    Exit.LATE: "the run finished, but answers were too late to judge the law; try --lockstep",
    Exit.INTERRUPTED: "ended by Ctrl-C or SIGTERM before it was done",
}
HELP = "exit codes:\n" + "\n".join(f"  {code:<4} {meaning.replace('`', '')}" for code, meaning in MEANINGS.items())


class Interrupted(Exception):  # noqa: N818 (not an error)
    """The user ended the command. kept: the folder of what was recorded, None if nothing was."""

    def __init__(self, kept: Path | None = None) -> None:
        super().__init__()
        self.kept = kept


@contextmanager
def stoppable() -> Iterator[threading.Event]:
    """Yield an event that SIGNALS set instead of ending the process; use in the main thread only.

    A second signal has no effect: shutting down takes seconds and has its own time limits.
    """
    stop, received = threading.Event(), SimpleQueue[Callable[[], None]]()
    threading.Thread(target=lambda: received.get()(), name="signals", daemon=True).start()
    # A handler that set the event would wait for ever if it interrupts this thread where that holds the event's lock.
    previous = [signal.signal(number, lambda *_: received.put(stop.set)) for number in SIGNALS]
    try:
        yield stop
    finally:
        for number, handler in zip(SIGNALS, previous, strict=True):
            signal.signal(number, handler)
        received.put(lambda: None)


def in_own_session() -> int | None:
    """Go on in a child process with a session of its own: return None there, and here its exit code once it has ended.

    Linux divides the cores among sessions (autogroup, sched(7)): a recorder in the session of a terminal waits for as
    long as a second while other programs of that terminal are busy. SIGNALS are passed on; the child gets
    SIGTERM when this process dies. Call it before any thread is started.
    """
    if sys.platform != "linux":
        return None
    parent, waited = os.getpid(), {*SIGNALS, signal.SIGCHLD}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, waited)
    child = os.fork()
    if child == 0:
        os.setsid()
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG of sys/prctl.h
        if os.getppid() != parent:
            os._exit(Exit.INTERRUPTED)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return None
    # The child is not reaped meanwhile: a signal that comes late still finds it. A handler in place of sigwait would
    # not run for a signal that comes just before a call that blocks.
    while os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT | os.WNOHANG) is None:
        received = signal.sigwait(waited)
        if received != signal.SIGCHLD:
            os.kill(child, received)
    on_signals(signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code < 0:
        print(f"fjr: the recorder was ended by {signal.Signals(-code).name}", file=sys.stderr)
    return code if code >= 0 else 128 - code
