# SPDX-License-Identifier: Apache-2.0
"""Times in nanoseconds: the steady clock, and stamps as text."""

from __future__ import annotations

import time


def steady() -> int:
    """Return the time of the steady clock [ns]."""
    return time.monotonic_ns()


def seconds(stamp: int) -> str:
    """Format a stamp [ns] in seconds with all digits."""
    sec, nanosec = divmod(stamp, 1_000_000_000)
    return f"{sec}.{nanosec:09d}"
