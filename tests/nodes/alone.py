# SPDX-License-Identifier: Apache-2.0
"""Run native loops in a process of their own; print modules that are loaded late, and allocations of the threads.

`python -m nodes.alone` with allocations.c preloaded, which counts what threads but the main one allocate.
"""

from __future__ import annotations

import ctypes
import sys
from typing import Any

from nodes.harness import Ros
from nodes.managed import Manager, trajectory

FIRST, LAST = 200, 700  # answered states between which allocations are counted in lock-step


def in_real_time(counter: Any) -> None:
    """Run an active controller through all that Python does in it; print the modules loaded after its activation.

    It tracks, changes gains and limits, follows, holds, plays, resumes, diagnoses a heavier link, and is deactivated.
    """
    with Ros() as ros:
        manager = Manager(ros)
        far = {"limits__tracking_error": [1e3], "limits__effort": [30.0]}  # no stop on a machine with little time
        node = ros.controller(**far, autostart=False)
        node.trigger_configure()
        node.trigger_activate()
        before = set(sys.modules)
        ros.meet()
        ros.plant(imperfections__motor_coulomb_friction=[0.05])
        loaded_by_plant = set(sys.modules) - before
        loop = node._control._command_loop._struct
        ros.until(lambda: loop.answered > FIRST, "the first states")
        counter.allocations_count(1)
        ros.until(lambda: any("mismatch" in s.message for m in manager.diagnostics for s in m.status), "the diagnosis")
        manager.trajectories.publish(trajectory((0.5, 0.3), (1.0, -0.2)))
        ros.until(lambda: "references changed" in manager.kinds(), "the trajectory")
        changed, _ = manager.set(gains__K_ld=[0.7], limits__tracking_error=[100.0])
        for name in ("hold", "play", "resume"):
            manager.trigger(name)
        counter.allocations_count(0)
        node.trigger_deactivate()
        print("changed" if changed else "unchanged")
        print(*("late:", *sorted(set(sys.modules) - before - loaded_by_plant)))


def in_lock_step(counter: Any) -> None:
    with Ros() as ros:
        node = ros.controller(use_sim_time=True)
        ros.plant(lockstep=True)
        loop = node._control._command_loop._struct
        ros.until(lambda: loop.answered >= FIRST, "the first states")
        counter.allocations_count(1)
        ros.until(lambda: loop.answered >= LAST, "the last state")
        counter.allocations_count(0)


if __name__ == "__main__":
    preloaded = ctypes.CDLL(None)
    in_real_time(preloaded)
    in_lock_step(preloaded)
    preloaded.allocations_print()
