# SPDX-License-Identifier: Apache-2.0
"""Environment without which rclpy.init fails or ends the process: the folder of the ROS 2 log files, the domain."""

from __future__ import annotations

import os
import sys
from pathlib import Path

LARGEST_DOMAIN = 232  # beyond it DDS has no ports


def domain() -> str:
    """Return the ROS domain of this process, as the environment has it."""
    return os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"


def domain_fault() -> str:
    """Return what is wrong with ROS_DOMAIN_ID, for which Fast DDS ends the process; "" if nothing is."""
    given = domain()
    if given.isascii() and given.isdigit() and int(given) <= LARGEST_DOMAIN:
        return ""
    return f"ROS_DOMAIN_ID is '{given}'; expected a whole number from 0 to {LARGEST_DOMAIN}"


def ensure_log_folder() -> None:
    """Set ROS_LOG_DIR to a new temporary folder if the usual one is not writable, and report it on standard error.

    The usual folder is $ROS_LOG_DIR, $ROS_HOME/log or ~/.ros/log. Child processes share the new folder.
    """
    try:
        folder = _usual()
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return
        reason = f"{folder} cannot be written"
    except OSError as error:
        reason = f"{error.filename} cannot be made ({error.strerror})" if error.filename else str(error)
    import tempfile  # loaded on use: a node starts sooner

    os.environ["ROS_LOG_DIR"] = tempfile.mkdtemp(prefix="fjr-ros-log-")
    print(f"{reason}; the log files of ROS 2 are in {os.environ['ROS_LOG_DIR']}", file=sys.stderr, flush=True)


def _usual() -> Path:
    for variable, below in (("ROS_LOG_DIR", ""), ("ROS_HOME", "log"), ("HOME", ".ros/log")):
        if os.environ.get(variable):
            return Path(os.environ[variable], below)
    raise OSError("HOME is not set")
