# SPDX-License-Identifier: Apache-2.0
"""The executable plant_node: set signal handlers and limit threads before anything loads that takes time."""

from __future__ import annotations

from fjr_msgs_py.node.loading import (
    ament_index_of_wheels,
    end_on_signals,
    name_process,
    pause_garbage_collection,
    require_resources,
    without_blas_threads,
)


def main() -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    end_on_signals()
    require_resources("plant_node")
    name_process("plant_node")
    pause_garbage_collection()
    without_blas_threads()
    ament_index_of_wheels()
    from fjr_plant.plant_node import main as run

    return run()
