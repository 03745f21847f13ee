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


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """SIGINT and SIGTERM end the process at once with exit code 0: nothing was started that would need an end.

    The handlers stay until process.run() puts its own in their place.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    yield
