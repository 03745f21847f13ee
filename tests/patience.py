# SPDX-License-Identifier: Apache-2.0
"""Limits on waiting: long enough where other processes keep the machine busy, short enough to end a test that hangs."""

from __future__ import annotations

import os
import time

HANG = 600.0  # s; a process that must end by itself and has not by then never does


class Limit:
    """A limit on one wait: `seconds` where the cores are free, longer in proportion to the load on each core."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._begun = time.monotonic()

    def passed(self) -> bool:
        """True once the wait has taken too long for the machine as it is now."""
        waited = time.monotonic() - self._begun
        return waited > self.seconds and waited > self.seconds * crowding()


def crowding() -> float:
    """Processes that want to run for each core, three times over; 1 at least."""
    return max(1.0, 3.0 * os.getloadavg()[0] / (os.cpu_count() or 1))
