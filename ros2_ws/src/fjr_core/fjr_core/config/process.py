# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node's process: compiled functions, executor, real-time scheduling, memory and cores."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ..errors import ParameterError
from .parameter import Parameter, Values

REALTIME_PRIORITY = Parameter(
    "realtime_priority",
    0,
    "SCHED_FIFO priority of the node's process where the system allows it; 0: ordinary scheduling",
    minimum=0,
    maximum=98,
)
LOCK_MEMORY = Parameter("lock_memory", False, "Keep the node's memory in RAM (mlockall) where the system allows it")
CPU_AFFINITY = Parameter(
    "cpu_affinity",
    "",
    "Cores that the node's process may use, where the system allows it; empty: any",
    constraint="core numbers and ranges with commas between, as taskset takes them: 1 or 0,2-3",
)
EXECUTOR = Parameter(
    "executor",
    "events",
    "rclpy's events executor (less processor time; where rclpy has it) or its single-threaded one",
    choices=("events", "single"),
)
COMPILE = Parameter("compile", True, "Run law and plant as compiled C where a C compiler is found")

_CORES = re.compile(r"(\d{1,4})(?:-(\d{1,4}))?")


def process_parameters() -> list[Parameter]:
    """The parameters of every node's process."""
    return [COMPILE, EXECUTOR, REALTIME_PRIORITY, LOCK_MEMORY, CPU_AFFINITY]


@dataclass(frozen=True)
class ProcessCare:
    """How a node's process is run: SCHED_FIFO priority (0: none), memory in RAM, cores (empty: any), executor."""

    priority: int = 0
    lock_memory: bool = False
    cores: frozenset[int] = frozenset()
    executor: str = "events"


def process_care(values: Values) -> ProcessCare:
    """The care of the values; raises ParameterError. In lock-step nothing is late: no priority."""
    priority = 0 if values.get("lockstep", False) else int(str(values[REALTIME_PRIORITY.name]))
    locked, executor = bool(values[LOCK_MEMORY.name]), str(values[EXECUTOR.name])
    return ProcessCare(priority, locked, cores(str(values[CPU_AFFINITY.name])), executor)


def cores(text: str) -> frozenset[int]:
    """The cores that a text like ``0,2-3`` names, none for an empty one; raises ParameterError."""
    found: set[int] = set()
    for part in text.split(",") if text.strip() else ():
        match = _CORES.fullmatch(part.strip())
        if not match:
            raise ParameterError(f"parameter '{CPU_AFFINITY.name}' is '{text}'; expected {CPU_AFFINITY.constraint}")
        first, last = int(match[1]), int(match[2] or match[1])
        found |= set(range(min(first, last), max(first, last) + 1))
    return frozenset(found)
