# SPDX-License-Identifier: Apache-2.0
"""The executable plant_node: set signal handlers and limit threads before anything loads that takes time."""

from __future__ import annotations

from fjr_msgs_py.node.loading import prepare


def main() -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    prepare("plant_node")
    from fjr_plant.plant_node import main as run

    return run()
