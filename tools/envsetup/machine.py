# SPDX-License-Identifier: Apache-2.0
"""What the machine has: the sourced ROS 2 or the wheels, a Python that fits, packages of Debian and Ubuntu."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from envsetup.commands import SetupError, run, say

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


def ros_interpreter() -> str:
    """Return the first interpreter that imports rclpy and the messages of the sourced ROS 2, the running one if it can.

    Raise SetupError if there is none.
    """
    found = (shutil.which(name) for name in ("python3", "/usr/bin/python3", "python3.12"))
    seen = []
    for candidate in dict.fromkeys([base_interpreter(), *(os.path.realpath(path) for path in found if path)]):
        done = subprocess.run([candidate, "-c", ROS_PYTHON_IMPORTS], capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return candidate
        seen.append(f"{candidate}: {(done.stderr.strip().splitlines() or ['no output'])[-1]}")
    raise SetupError(
        "ROS_DISTRO=jazzy is set, but no Python here imports rclpy and the common messages: source "
        "/opt/ros/jazzy/setup.sh again and see that ros-jazzy-rclpy and its common interfaces are installed.",
        "\n".join(seen),
    )


@dataclass(frozen=True)
class Extra:
    """title: name. packages: of Debian or Ubuntu that provide it. without: consequence of its absence.

    checks: commands of which one succeeds where it is there, with `given` as input. required: nothing works without.
    """

    title: str
    packages: tuple[str, ...]
    without: str
    checks: Sequence[Sequence[str]]
    given: bytes = b""
    required: bool = False

    def is_there(self, env: Mapping[str, str]) -> bool:
        """Return whether one of the checks succeeds."""
        return any(_succeeds(check, env, self.given) for check in self.checks)

    def ensure(self, log: Path, env: dict[str, str]) -> bool:
        """Install the packages if possible; return whether it is there, after one line if not.

        Raise SetupError if it is required and cannot be installed.
        """
        if self.is_there(env):
            return True
        names, details = " ".join(self.packages), ""
        if not self.packages or not shutil.which("apt-get"):
            reason = "; install it if you can"
        elif os.geteuid() != 0:
            reason = f"; ask an administrator for `apt-get install {names}`"
        else:
            try:
                say(f"{self.title} is missing and will be installed")
                apt_install(self.packages, log, env)
                if self.is_there(env):
                    return True
                reason = f", although {' and '.join(self.packages)} are installed"
            except SetupError as error:
                reason, details = f"; {error}", error.details
        lack = f"{self.title} is missing: {self.without}{reason}"
        if self.required:
            raise SetupError(lack, details)
        say(lack)
        return False


def apt_install(packages: tuple[str, ...], log: Path, env: dict[str, str]) -> None:
    """Install packages as root; raise SetupError if apt-get fails."""
    apt, names = {**env, "DEBIAN_FRONTEND": "noninteractive"}, " ".join(packages)
    log.unlink(missing_ok=True)
    run("apt-get update", ["apt-get", "update"], log, apt, "apt-get update failed")
    command = ["apt-get", "install", "-y", "--no-install-recommends", *packages]
    run(f"apt-get install {names}", command, log, apt, f"apt-get could not install {names}")


def venv_module() -> Extra:
    """Return `venv` of this interpreter, part of which Debian and Ubuntu ship in a separate package."""
    python, version = base_interpreter(), "{}.{}".format(*sys.version_info)
    packages = (f"python{version}-venv",) if python.startswith("/usr/bin/") else ()
    without = "no environment can be made by this Python; name another one (make PYTHON=...)"
    checks = [[python, "-c", "import ensurepip, venv"]]
    return Extra(f"the module venv of {python}", packages, without, checks, required=True)


def compiler(env: Mapping[str, str], python: Path) -> Extra:
    """Return the C compiler of the nodes: $CC, or cc, gcc or clang with the C library's headers, or ziglang's."""
    wanted = env.get("CC", "").split()
    compilers = [wanted] if wanted else [["cc"], ["gcc"], ["clang"], [str(python), "-m", "ziglang", "cc"]]
    checks = [[*each, "-fsyntax-only", "-x", "c", "-"] for each in compilers]
    instead = "ziglang from PyPI (100 MB) takes its place and compiles more slowly"
    return Extra("a C compiler (cc, gcc or clang)", ("gcc", "libc6-dev"), instead, checks, b"#include <math.h>\n")


def extras(target: str, python: Path, sourced_ros: bool) -> Iterator[Extra]:
    """Yield what a target can use: Pinocchio beside a sourced ROS 2, C++ compiler and browser."""
    if sourced_ros and target in ("test", "bench"):
        yield pinocchio(python)
    if target == "test":
        fails = "tests of `fjr export-c` that call C from C++ fail"
        check = ["c++", "-fsyntax-only", "-x", "c++", "-"]
        yield Extra("a C++ compiler (c++)", ("g++",), fails, [check], b"#include <vector>\n")
        browsers = [[name, "--version"] for name in ("chromium", "chromium-browser", "google-chrome")]
        yield Extra("Chromium", ("chromium",), "tests that look at pages in a browser are skipped", browsers)


def pinocchio(python: Path) -> Extra:
    """Return the Pinocchio of a sourced ROS 2, which tests and benchmarks compare with."""
    fails = "tests and benchmarks that compare with it fail"
    return Extra("Pinocchio", ("ros-jazzy-pinocchio",), fails, [[str(python), "-c", "import pinocchio"]])


def _succeeds(command: Sequence[str], env: Mapping[str, str], given: bytes) -> bool:
    try:
        return subprocess.run(command, input=given, env=env, capture_output=True, check=False).returncode == 0
    except OSError:
        return False
