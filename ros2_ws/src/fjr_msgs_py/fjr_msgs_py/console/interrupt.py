# SPDX-License-Identifier: Apache-2.0
"""Shut down in order on SIGINT and SIGTERM: nodes, recorder, then this process."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from fjr_msgs_py.node.loading import SIGNALS


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
