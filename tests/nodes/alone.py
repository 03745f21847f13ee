# SPDX-License-Identifier: Apache-2.0
"""Programs that a test of the native loops runs in a process of its own."""

from __future__ import annotations

import ctypes
import sys

from nodes.harness import Ros
from nodes.managed import Manager, trajectory

STATES = 3000  # some seconds, for the diagnosis of a fault
FIRST, LAST = 200, 700  # answered states between which allocations are counted


def late_imports() -> None:
    """Run an active controller through all that Python does in it; print the modules loaded after its activation.

    It tracks, changes gains and limits, follows, holds, plays, resumes, diagnoses a heavier link, and is deactivated.
    """
    with Ros() as ros:
        manager = Manager(ros)
        node = ros.controller(limits__tracking_error=[3.0])
        before = set(sys.modules)
        manager.meet_controller()
        ros.plant(imperfections__motor_coulomb_friction=[0.05])
        loaded_by_plant = set(sys.modules) - before
        loop = node._control._command_loop._struct
        ros.until(lambda: loop.answered > STATES, "the states")
        ros.until(lambda: any("mismatch" in s.message for m in manager.diagnostics for s in m.status), "the diagnosis")
        ros.until(lambda: ros.matched(manager.trajectories), "the trajectory's subscription")
        manager.trajectories.publish(trajectory((0.5, 0.3), (1.0, -0.2)))
        ros.until(lambda: "references changed" in manager.kinds(), "the trajectory")
        changed, _ = manager.set(gains__K_ld=[0.7], limits__tracking_error=[2.5])
        for name in ("hold", "play", "resume"):
            manager.trigger(name)
        node.trigger_deactivate()
        print("changed" if changed else "unchanged")
        print(*("late:", *sorted(set(sys.modules) - before - loaded_by_plant)))


def count_allocations() -> None:
    """Run both nodes in lock-step and in real time; let allocations.c count what threads but the main one allocate."""
    counter = ctypes.CDLL(None)
    for simulated in (True, False):
        with Ros() as ros:
            node = ros.controller(use_sim_time=simulated)
            ros.plant(lockstep=simulated)
            loop = node._control._command_loop._struct
            ros.until(lambda: loop.answered >= FIRST, "the first states")  # noqa: B023
            counter.allocations_count(1)
            ros.until(lambda: loop.answered >= LAST, "the last state")  # noqa: B023
            counter.allocations_count(0)
        counter.allocations_print()


if __name__ == "__main__":
    {"late_imports": late_imports, "count_allocations": count_allocations}[sys.argv[1]]()
