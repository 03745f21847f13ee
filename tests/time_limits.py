# SPDX-License-Identifier: Apache-2.0
"""Time limits of tests, which grow with the load of the machine and still end a test that hangs."""

from __future__ import annotations

import os
import time

HANG = 600.0  # s; timeout of a process that must end by itself


class Limit:
    """A time limit of `seconds` on an idle machine, extended in proportion to the load per core."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._begun = time.monotonic()

    def passed(self) -> bool:
        """Return whether the wait exceeds the limit at the present load."""
        waited = time.monotonic() - self._begun
        return waited > self.seconds and waited > self.seconds * crowding()


def crowding() -> float:
    """Return three times the number of runnable processes per core, at least 1."""
    return max(1.0, 3.0 * os.getloadavg()[0] / (os.cpu_count() or 1))
