# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling of a whole process, where the system allows it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress


def take_priority(priority: int) -> str:
    """Schedule every thread of this process as SCHED_FIFO at `priority` (0: leave it as it is).

    Returns an empty string, or a sentence that says why it is not so.
    """
    if priority == 0:
        return ""
    try:
        _schedule(os.SCHED_FIFO, priority)
    except (OSError, AttributeError) as error:
        return (
            f"realtime_priority {priority} is refused ({error}): ordinary scheduling is used, cycles will come later; "
            "allow it by an rtprio limit (/etc/security/limits.conf) or CAP_SYS_NICE, or set realtime_priority to 0"
        )
    return ""


@contextmanager
def prioritised(priority: int) -> Iterator[None]:
    """Real-time scheduling of this process inside the block, where the system allows it, else nothing."""
    refused = take_priority(priority)
    try:
        yield
    finally:
        if priority and not refused:
            _schedule(os.SCHED_OTHER, 0)


def _schedule(policy: int, priority: int) -> None:
    for thread in os.listdir("/proc/self/task"):
        with suppress(ProcessLookupError):  # a thread that has just ended
            os.sched_setscheduler(int(thread), policy, os.sched_param(priority))
