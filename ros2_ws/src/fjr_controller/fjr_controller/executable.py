# SPDX-License-Identifier: Apache-2.0
"""The executable controller_node: set signal handlers, limit threads, join the DDS domain, then load the rest."""

from __future__ import annotations

from fjr_msgs_py.node.loading import prepare


def main() -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    prepare("controller_node")
    from fjr_msgs_py.node.participant import join

    join()
    from fjr_controller.controller_node import main as run

    return run()
