# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM as a wish granted in order: nodes first, then the recorder, then this process."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class Interrupted(Exception):  # noqa: N818 (not an error)
    """The user ended the run. `kept`: the folder with what was recorded, None when nothing was."""

    def __init__(self, kept: Path | None = None) -> None:
        super().__init__()
        self.kept = kept


@contextmanager
def stoppable() -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set instead of ending the process; in the main thread only.

    Ending takes a second or two and has time limits of its own, so asking again changes nothing.
    """
    stop = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM)
    previous = [signal.signal(number, lambda *_: stop.set()) for number in numbers]
    try:
        yield stop
    finally:
        for number, handler in zip(numbers, previous, strict=True):
            signal.signal(number, handler)


def at_once() -> None:
    """From here on a signal ends the process: there is nothing to end in order."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
