# SPDX-License-Identifier: Apache-2.0
"""Choose the ROS 2 for this machine: the sourced installation or the wheels."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterable

from envsetup.console import SetupError

DISTRO = "jazzy"
OLDEST_GLIBC = (2, 28)
ROS_PYTHON_IMPORTS = (
    "import rclpy.node, sensor_msgs.msg, std_msgs.msg, std_srvs.srv, "
    "diagnostic_msgs.msg, trajectory_msgs.msg, rosgraph_msgs.msg"
)


def has_wheels() -> bool:
    """Return whether ROS 2 wheels exist for this machine (manylinux_2_28, x86-64, CPython)."""
    libc, version = platform.libc_ver()
    return (
        platform.system() == "Linux"
        and platform.machine().lower() in {"x86_64", "amd64"}
        and sys.maxsize > 2**32
        and libc == "glibc"
        and tuple(int(part) for part in version.split(".") if part.isdigit()) >= OLDEST_GLIBC
        and sys.implementation.name == "cpython"
    )


def uses_sourced_ros() -> bool:
    """Return True for the sourced ROS 2 Jazzy, False for the wheels; raise SetupError if neither is possible."""
    distro = os.environ.get("ROS_DISTRO", "")
    if distro == DISTRO:
        return True
    if distro:
        raise SetupError(
            f"ROS 2 Jazzy is needed, but ROS_DISTRO={distro} is sourced here: source "
            "/opt/ros/jazzy/setup.sh instead, or start from a shell in which no ROS is sourced."
        )
    if not has_wheels():
        bits = "" if sys.maxsize > 2**32 else "32-bit Python on "
        libc = " ".join(platform.libc_ver()).strip() or "unknown C library"
        raise SetupError(
            f"This machine is {platform.system()} on {bits}{platform.machine()} with {libc} and "
            f"{sys.implementation.name}, for which ROS 2 Jazzy does not come as wheels (they need Linux "
            "on x86_64 with glibc 2.28 or newer and CPython): install ROS 2 Jazzy, source "
            "/opt/ros/jazzy/setup.sh and run the same command again."
        )
    return False


def base_interpreter() -> str:
    """Return the interpreter outside any virtual environment."""
    return os.path.realpath(getattr(sys, "_base_executable", sys.executable) or sys.executable)


def ros_interpreter(candidates: Iterable[str]) -> str:
    """Return the first interpreter that imports rclpy and the messages of the sourced ROS 2; raise SetupError."""
    seen = []
    for candidate in candidates:
        try:
            command = [candidate, "-c", ROS_PYTHON_IMPORTS]
            run = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError:
            continue
        if run.returncode == 0:
            return candidate
        seen.append(f"{candidate}: {(run.stderr.strip().splitlines() or ['no output'])[-1]}")
    raise SetupError(
        "ROS_DISTRO=jazzy is set, but no Python here imports rclpy and the common messages: source "
        "/opt/ros/jazzy/setup.sh again and see that ros-jazzy-rclpy and its common interfaces are installed.",
        "\n".join(seen),
    )


def ros_candidates() -> list[str]:
    """Return candidate interpreters for a sourced ROS 2, the running one first."""
    found = (shutil.which(name) for name in ("python3", "/usr/bin/python3", "python3.12"))
    return list(dict.fromkeys([base_interpreter(), *(os.path.realpath(path) for path in found if path)]))
