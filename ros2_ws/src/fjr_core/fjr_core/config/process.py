# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node's process: compiled functions, executor, real-time scheduling, memory and cores."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ..errors import ParameterError
from ..numerics.parameter_field import declared, parameter_field
from .parameter import Parameter, Values, read, table

COMPILE = Parameter("compile", True, "Run law and plant as compiled C where a C compiler is found")
CPU_AFFINITY = Parameter(
    "cpu_affinity",
    "",
    "Cores that the node's process may use, where the system allows it; empty: any",
    constraint="core numbers and ranges separated by commas, as for taskset: 1 or 0,2-3",
)
NATIVE = "native"
_CORES = re.compile(r"(\d{1,4})(?:-(\d{1,4}))?")


@dataclass(frozen=True)
class ProcessSettings:
    """Settings of a node's process. cores: those it may use (cpu_affinity); empty for any."""

    priority: int = parameter_field(
        0,
        "SCHED_FIFO priority of the node's process where the system allows it; 0: ordinary scheduling",
        name="realtime_priority",
        minimum=0,
        maximum=98,
    )
    lock_memory: bool = parameter_field(False, "Keep the node's memory in RAM (mlockall) where the system allows it")
    cores: frozenset[int] = frozenset()
    executor: str = parameter_field(
        NATIVE,
        "Loop of commands and states: a native thread in C (where it can be built), or rclpy's events executor (where "
        "rclpy has it), or its single-threaded one",
        choices=(NATIVE, "events", "single"),
    )


_DECLARED = declared(ProcessSettings)


def process_parameters() -> list[Parameter]:
    """Return the parameters of every node's process."""
    return [COMPILE, CPU_AFFINITY, *table(_DECLARED, 0)]


def process_settings(values: Values) -> ProcessSettings:
    """Return the process settings of the values; raises ParameterError.

    The priority is 0 in lock-step, which has no deadline.
    """
    settings = read(_DECLARED, values, 0)
    if values.get("lockstep", False):
        settings["priority"] = 0
    return ProcessSettings(**settings, cores=cores(str(values[CPU_AFFINITY.name])))


def cores(text: str) -> frozenset[int]:
    """Parse a list of cores such as ``0,2-3``; an empty text gives none. Raises ParameterError."""
    found: set[int] = set()
    for part in text.split(",") if text.strip() else ():
        match = _CORES.fullmatch(part.strip())
        if not match:
            raise ParameterError(f"parameter '{CPU_AFFINITY.name}' is '{text}'; expected {CPU_AFFINITY.constraint}")
        first, last = int(match[1]), int(match[2] or match[1])
        found |= set(range(min(first, last), max(first, last) + 1))
    return frozenset(found)
