# SPDX-License-Identifier: Apache-2.0
"""Run plant and controller with native loops, in lock-step and in real time; print what allocations.c has counted."""

from __future__ import annotations

import ctypes

from nodes.harness import Ros

FIRST, LAST = 200, 700  # answered states between which allocations are counted


def count(simulated: bool) -> None:
    """Count the allocations of all threads but the main one, in a pair of nodes of its own."""
    counter, ros = ctypes.CDLL(None), Ros()
    node = ros.controller(executor="native", compile=True, use_sim_time=simulated)
    ros.plant(executor="native", compile=True, lockstep=simulated)
    loop = node._control._command_loop._struct
    ros.until(lambda: loop.answered >= FIRST, "the first states")
    counter.allocations_count(1)
    ros.until(lambda: loop.answered >= LAST, "the last state")
    counter.allocations_count(0)
    ros.close()
    counter.allocations_print()


if __name__ == "__main__":
    for simulated in (True, False):
        count(simulated)
