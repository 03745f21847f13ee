# SPDX-License-Identifier: Apache-2.0
"""Prefer ROS 2's own command where it is installed."""

from __future__ import annotations

from fjr_core.errors import FjrError
from fjr_msgs_py.console.ros2_tools import ros2_path


class BetterToolError(FjrError):
    """ROS 2's own tool is installed."""


def refuse_over_ros2(command: str, advantage: str, force: bool) -> None:
    """Raise BetterToolError, naming the `command` of ros2 to use, if ros2 is on the PATH, unless forced."""
    if not force and (found := ros2_path()):
        raise BetterToolError(f"{found} does this better: use `{command}` ({advantage}), or add --force")
