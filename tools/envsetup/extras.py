# SPDX-License-Identifier: Apache-2.0
"""System packages of Debian and Ubuntu in addition to the pinned ones, by apt-get."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from envsetup.console import SetupError, Step, run_logged, say

COMPILERS = ("cc", "gcc", "clang")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@dataclass(frozen=True)
class Extra:
    """title: name. packages: of Debian or Ubuntu that provide it. without: consequence of its absence."""

    title: str
    packages: tuple[str, ...]
    without: str
    is_there: Callable[[], bool]

    def ensure(self, log: Path, env: dict[str, str]) -> None:
        """Install the package if possible; otherwise print one line and continue."""
        if self.is_there():
            return
        lack = f"{self.title} is missing: {self.without}"
        names = " ".join(self.packages)
        if not has_apt():
            say(f"{lack}; install it if you can")
        elif os.geteuid() != 0:
            say(f"{lack}; ask an administrator for `apt-get install {names}`")
        else:
            self._install(lack, log, env)

    def _install(self, lack: str, log: Path, env: dict[str, str]) -> None:
        log.unlink(missing_ok=True)
        say(f"{self.title} is missing and will be installed")
        try:
            apt_install(self.packages, log, env)
        except SetupError as error:
            say(f"{lack}; {error}")
            return
        if not self.is_there():
            say(f"{lack}, although {' and '.join(self.packages)} are installed")


def has_apt() -> bool:
    """Return whether apt-get is available."""
    return any(Path(folder, "apt-get").exists() for folder in ("/usr/bin", "/bin"))


def apt_install(packages: tuple[str, ...], log: Path, env: dict[str, str]) -> None:
    """Install packages as root; raise SetupError if apt-get fails."""
    apt, names = {**env, "DEBIAN_FRONTEND": "noninteractive"}, " ".join(packages)
    with Step("apt-get update") as step:
        run_logged(["apt-get", "update"], log, apt, step, failure="apt-get update failed")
    with Step(f"apt-get install {names}") as step:
        command = ["apt-get", "install", "-y", "--no-install-recommends", *packages]
        run_logged(command, log, apt, step, failure=f"apt-get could not install {names}")


def compiler(env: dict[str, str]) -> Extra:
    """Return the C compiler for law and plant."""
    slow = "law and plant run in CasADi's virtual machine, many times slower"
    return Extra("a C compiler (cc, gcc or clang)", ("gcc", "libc6-dev"), slow, lambda: has_compiler(env))


def cpp_compiler(env: dict[str, str]) -> Extra:
    """Return the C++ compiler with which tests call exported C."""
    check, code = ["c++", "-fsyntax-only", "-x", "c++", "-"], b"#include <vector>\n"
    fails = "tests of `fjr export-c` that call C from C++ fail"
    return Extra("a C++ compiler (c++)", ("g++",), fails, lambda: _succeeds(check, env, code))


def pinocchio(python: Path, env: dict[str, str]) -> Extra:
    """Return the Pinocchio of a sourced ROS 2, which tests and benchmarks compare with."""
    fails = "tests and benchmarks that compare with it fail"
    return Extra(
        "Pinocchio", ("ros-jazzy-pinocchio",), fails, lambda: _succeeds([str(python), "-c", "import pinocchio"], env)
    )


def browser(env: dict[str, str]) -> Extra:
    """Return the headless browser in which tests open the pages of `fjr report`."""

    def is_there() -> bool:
        return any(_succeeds([name, "--version"], env) for name in BROWSERS)

    return Extra("Chromium", ("chromium",), "tests that look at pages in a browser are skipped", is_there)


def has_compiler(env: dict[str, str]) -> bool:
    """Return whether $CC, or one of COMPILERS on the path, finds the headers of the C library."""
    wanted = env.get("CC", "").split()
    commands = [wanted] if wanted else [[name] for name in COMPILERS]
    check, code = ["-fsyntax-only", "-x", "c", "-"], b"#include <math.h>\n"
    return any(_succeeds([*command, *check], env, code) for command in commands)


def _succeeds(command: list[str], env: dict[str, str], given: bytes = b"") -> bool:
    try:
        return subprocess.run(command, input=given, env=env, capture_output=True, check=False).returncode == 0
    except OSError:
        return False
