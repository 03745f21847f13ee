# SPDX-License-Identifier: Apache-2.0
"""How a command ends: its exit code, and an orderly shutdown on SIGINT and SIGTERM."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from types import FrameType

from ..node.loading import SIGNALS


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
    Exit.LATE: "the run finished, but the computer answered too late to judge the law; try --lockstep",
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
    """Yield an event that SIGINT and SIGTERM set instead of ending the process; use in the main thread only.

    A second signal has no effect: shutting down takes seconds and has its own time limits.
    """
    stop = threading.Event()
    previous = [signal.signal(number, lambda *_: stop.set()) for number in SIGNALS]
    try:
        yield stop
    finally:
        for number, handler in zip(SIGNALS, previous, strict=True):
            signal.signal(number, handler)


def interruptible() -> None:
    """Raise KeyboardInterrupt in the main thread on SIGINT and SIGTERM, except within `stoppable`."""
    for number in SIGNALS:
        signal.signal(number, _interrupt)


def uninterruptible() -> None:
    """Ignore SIGINT and SIGTERM; use when the process is about to end."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
