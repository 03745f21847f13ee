# SPDX-License-Identifier: Apache-2.0
"""Name what works on this installation: a command of ROS 2 or that of `fjr`, and how to install what is missing."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

INSTALLATION = (
    "expected the wheel fjr in this Python environment, or a workspace that is built (make build) and sourced "
    "(. ros2_ws/install/setup.sh)"
)


def ros2_path() -> str | None:
    """Return the path of the ROS command line; None if it is not installed, as with ROS 2 from wheels."""
    return shutil.which("ros2")


def installed_command(ros2: str, fjr: str) -> str:
    """Return the command `ros2 ...` if ROS 2's command line is installed, otherwise `fjr ...`."""
    return f"ros2 {ros2}" if ros2_path() else f"fjr {fjr}"


def play_command(bag: Path) -> str:
    """Return the command that plays a bag."""
    name = shlex.quote(str(bag))
    return installed_command(f"bag play {name}", f"play {name}")
