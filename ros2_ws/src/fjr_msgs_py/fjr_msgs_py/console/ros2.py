# SPDX-License-Identifier: Apache-2.0
"""What this installation offers: files, ROS 2's own command or that of fjr, a DDS profile with quick discovery.

The wheels of ROS 2 hold no `ros2` command. Where it is installed it is preferred: it knows every type and option.
Where it is not, `fjr` has the few commands that a run needs. This module loads nothing slow.
"""

from __future__ import annotations

import os
import shlex
import shutil
from pathlib import Path

from fjr_core.errors import FjrError

from ..node.loading import ensure_log_folder, environment_fault

INSTALLATION = (
    "expected the wheel fjr in this Python environment, or a workspace that is built (make build) and sourced "
    "(. ros2_ws/install/setup.sh)"
)


def installed_files(kind: str) -> dict[str, Path]:
    """Return the installed files of a kind (scenarios, sweeps, suites) by name; none where no workspace is sourced."""
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory  # loaded on use

    try:
        folder = Path(get_package_share_directory("fjr_bringup"), kind)
    except (PackageNotFoundError, OSError):
        return {}
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def play_command(bag: Path) -> str:
    """Return the command that plays a bag: that of ROS 2 if its command line is installed, otherwise of fjr."""
    player = "ros2 bag play" if shutil.which("ros2") else "fjr play"
    return f"{player} {shlex.quote(str(bag))}"


def refuse_over_ros2(command: str, advantage: str, force: bool) -> None:
    """Raise FjrError, naming the `command` of ros2 to use, if ros2 is on the PATH, unless forced."""
    if not force and (found := shutil.which("ros2")):
        raise FjrError(f"{found} does this better: use `{command}` ({advantage}), or add --force")


def discover_quickly(locally: bool = False) -> None:
    """Use a DDS profile with quick discovery unless the user set another; set the folder of the ROS 2 logs.

    locally: discover this machine only, unless the user set a range. Raises FjrError for an invalid ROS_DOMAIN_ID.
    """
    from ament_index_python.packages import get_package_share_directory  # loaded on use

    if fault := environment_fault():
        raise FjrError(fault)
    ensure_log_folder()
    profile = Path(get_package_share_directory("fjr_bringup"), "config", "fastdds.xml")
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
    if locally:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
