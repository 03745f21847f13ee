# SPDX-License-Identifier: Apache-2.0
"""The plant in C."""

from __future__ import annotations

from functools import cache

from fjr_msgs_py.native.program import Program


@cache
def plant_program() -> Program:
    """Return the program of this process, compiled and cached; raises CompilerError without a C compiler."""
    headers = "robot.h", "channel.h", "plant.h"
    return Program.of("fjr_plant", [*headers, "robot.c", "channel.c", "time_base.c", "real_time.c", "lock_step.c"])
