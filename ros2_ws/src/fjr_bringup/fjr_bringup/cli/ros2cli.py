# SPDX-License-Identifier: Apache-2.0
"""`fjr echo` and `fjr record` stand in where ROS 2's own command line is missing; where it is there, it is better."""

from __future__ import annotations

import shutil

from fjr_core.errors import FjrError


class BetterToolError(FjrError):
    """ROS 2's own tool is installed."""


def refuse_where_better(command: str, what: str, force: bool) -> None:
    """Raise BetterToolError, naming the `command` of ros2 to use, where ros2 is on the PATH, unless forced."""
    if not force and (found := shutil.which("ros2")):
        raise BetterToolError(f"{found} is there and does this better: use `{command}` ({what}), or add --force")
