# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node's process: compiled functions and real-time scheduling."""

from __future__ import annotations

from .parameters import Parameter

REALTIME_PRIORITY = Parameter(
    "realtime_priority",
    0,
    "SCHED_FIFO priority of the node's process where the system allows it; 0: ordinary scheduling",
    minimum=0,
    maximum=98,
)
COMPILE = Parameter("compile", True, "Run law and plant as compiled C where a C compiler is found")


def process_parameters() -> list[Parameter]:
    """The parameters of every node's process."""
    return [COMPILE, REALTIME_PRIORITY]
