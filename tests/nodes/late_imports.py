# SPDX-License-Identifier: Apache-2.0
"""Run an active controller through all that Python does in it; print the modules that were loaded after activation."""

from __future__ import annotations

import sys

from nodes.harness import Ros
from nodes.managed import Manager, trajectory

STATES = 3000  # some seconds, for the diagnosis of a fault


def main() -> None:
    """Track, change gains and limits, follow, hold, play, resume, diagnose a heavier link, and deactivate."""
    ros = Ros()
    manager = Manager(ros)
    node = ros.controller(executor="native", compile=True, limits__tracking_error=[3.0])
    before = set(sys.modules)
    manager.meet_controller()
    ros.plant(executor="native", compile=True, imperfections__motor_coulomb_friction=[0.05])
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
    ros.close()


if __name__ == "__main__":
    main()
