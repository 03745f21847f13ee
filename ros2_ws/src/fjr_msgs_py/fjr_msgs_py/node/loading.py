# SPDX-License-Identifier: Apache-2.0
"""What must be set before a process loads ROS 2, NumPy and CasADi; this module itself loads none of them."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager


def without_blas_threads() -> None:
    """One thread for NumPy's linear algebra, unless the user chose: on matrices of a robot's size more only wait."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


SIGNALS = (signal.SIGINT, signal.SIGTERM)


def end_on_signals(code: int = 0) -> None:
    """End the process at once with an exit code on SIGINT or SIGTERM: nothing was started that would need an end.

    Signals that the installed executables block while Python starts (scripts/ in each package) arrive from here on.
    The handlers stay until others, as those of process.run(), take their place.
    """
    for number in SIGNALS:
        signal.signal(number, lambda *_: os._exit(code))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


@contextmanager
def signals_blocked() -> Iterator[None]:
    """Block SIGINT and SIGTERM in this thread; a process started meanwhile begins with them blocked."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
