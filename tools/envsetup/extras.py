# SPDX-License-Identifier: Apache-2.0
"""System packages of Debian and Ubuntu in addition to the pinned ones, by apt-get."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from envsetup.console import SetupError, Step, run_logged, say
from envsetup.machine import base_interpreter

COMPILERS = ("cc", "gcc", "clang")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


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

    def ensure(self, log: Path, env: dict[str, str]) -> None:
        """Install the packages if possible; otherwise print one line and continue, or raise SetupError if required."""
        if self.is_there(env):
            return
        names, details = " ".join(self.packages), ""
        if not self.packages or not has_apt():
            reason = "; install it if you can"
        elif os.geteuid() != 0:
            reason = f"; ask an administrator for `apt-get install {names}`"
        else:
            log.unlink(missing_ok=True)
            say(f"{self.title} is missing and will be installed")
            try:
                apt_install(self.packages, log, env)
                if self.is_there(env):
                    return
                reason = f", although {' and '.join(self.packages)} are installed"
            except SetupError as error:
                reason, details = f"; {error}", error.details
        lack = f"{self.title} is missing: {self.without}{reason}"
        if self.required:
            raise SetupError(lack, details)
        say(lack)


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


def venv_module() -> Extra:
    """Return `venv` of this interpreter, part of which Debian and Ubuntu ship in a separate package."""
    python, version = base_interpreter(), "{}.{}".format(*sys.version_info)
    packages = (f"python{version}-venv",) if python.startswith("/usr/bin/") else ()
    without = "no environment can be made by this Python; name another one (make PYTHON=...)"
    checks = [[python, "-c", "import ensurepip, venv"]]
    return Extra(f"the module venv of {python}", packages, without, checks, required=True)


def compiler(env: Mapping[str, str]) -> Extra:
    """Return the C compiler for law and plant: $CC, or one of COMPILERS, that finds the headers of the C library."""
    wanted = env.get("CC", "").split()
    checks = [[*each, "-fsyntax-only", "-x", "c", "-"] for each in ([wanted] if wanted else [[c] for c in COMPILERS])]
    slow = "law and plant run in CasADi's virtual machine, many times slower"
    packages = "gcc", "libc6-dev"
    return Extra("a C compiler (cc, gcc or clang)", packages, slow, checks, b"#include <math.h>\n")


CPP_COMPILER = Extra(
    "a C++ compiler (c++)",
    ("g++",),
    "tests of `fjr export-c` that call C from C++ fail",
    [["c++", "-fsyntax-only", "-x", "c++", "-"]],
    b"#include <vector>\n",
)
BROWSER = Extra(
    "Chromium",
    ("chromium",),
    "tests that look at pages in a browser are skipped",
    [[name, "--version"] for name in BROWSERS],
)


def pinocchio(python: Path) -> Extra:
    """Return the Pinocchio of a sourced ROS 2, which tests and benchmarks compare with."""
    fails = "tests and benchmarks that compare with it fail"
    return Extra("Pinocchio", ("ros-jazzy-pinocchio",), fails, [[str(python), "-c", "import pinocchio"]])


def _succeeds(command: Sequence[str], env: Mapping[str, str], given: bytes) -> bool:
    try:
        return subprocess.run(command, input=given, env=env, capture_output=True, check=False).returncode == 0
    except OSError:
        return False
