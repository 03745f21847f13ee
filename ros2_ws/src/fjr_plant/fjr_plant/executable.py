# SPDX-License-Identifier: Apache-2.0
"""The executable plant_node: signals and threads are in hand before anything that takes time is loaded."""

from __future__ import annotations

from fjr_msgs_py.loading import ended_by_signals, without_blas_threads


def main() -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    without_blas_threads()
    with ended_by_signals():
        from fjr_plant.plant_node import main as run
    return run()
