# SPDX-License-Identifier: Apache-2.0
"""Choose the ROS 2 for this machine: the sourced installation or the wheels."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from envsetup.console import SetupError
from envsetup.extras import has_apt

DISTRO = "jazzy"
OLDEST_GLIBC = (2, 28)
ROS_PYTHON_IMPORTS = (
    "import rclpy.node, sensor_msgs.msg, std_msgs.msg, std_srvs.srv, "
    "diagnostic_msgs.msg, trajectory_msgs.msg, rosgraph_msgs.msg"
)


@dataclass(frozen=True)
class Machine:
    """Properties of the machine that determine the choice.

    system, architecture: as of `platform`, e.g. Linux, x86_64. libc: name of the C library, e.g. glibc; empty if
    unknown. implementation: `sys.implementation.name`, e.g. cpython. ros_distro: empty if no ROS is sourced.
    """

    system: str
    architecture: str
    libc: str
    libc_version: tuple[int, ...]
    implementation: str
    ros_distro: str

    @classmethod
    def here(cls, environ: Mapping[str, str] = os.environ) -> Machine:
        """Return the properties of this machine."""
        name, version = platform.libc_ver()
        numbers = tuple(int(part) for part in version.split(".") if part.isdigit())
        architecture = platform.machine() if sys.maxsize > 2**32 else f"32-bit Python on {platform.machine()}"
        distro = environ.get("ROS_DISTRO", "")
        return cls(platform.system(), architecture, name, numbers, sys.implementation.name, distro)

    def __str__(self) -> str:
        libc = f"{self.libc} {'.'.join(map(str, self.libc_version))}" if self.libc else "unknown C library"
        return f"{self.system} on {self.architecture} with {libc} and {self.implementation}"


def has_wheels(machine: Machine) -> bool:
    """Return whether ROS 2 wheels exist for this machine (manylinux_2_28, x86-64, CPython)."""
    return (
        machine.system == "Linux"
        and machine.architecture.lower() in {"x86_64", "amd64"}
        and machine.libc == "glibc"
        and machine.libc_version >= OLDEST_GLIBC
        and machine.implementation == "cpython"
    )


def uses_sourced_ros(machine: Machine) -> bool:
    """Return True for the sourced ROS 2 Jazzy, False for the wheels; raise SetupError if neither is possible."""
    if machine.ros_distro == DISTRO:
        return True
    if machine.ros_distro:
        raise SetupError(
            f"ROS 2 Jazzy is needed, but ROS_DISTRO={machine.ros_distro} is sourced here: source "
            "/opt/ros/jazzy/setup.sh instead, or start from a shell in which no ROS is sourced."
        )
    if not has_wheels(machine):
        raise SetupError(
            f"This machine is {machine}, for which ROS 2 Jazzy does not come as wheels (they need Linux "
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


def debian_venv_package() -> str:
    """Return the Debian or Ubuntu package with `venv` for this interpreter; empty on other systems."""
    is_system_python = base_interpreter().startswith("/usr/bin/")
    return f"python{sys.version_info[0]}.{sys.version_info[1]}-venv" if has_apt() and is_system_python else ""
