# SPDX-License-Identifier: Apache-2.0
"""Install packages of Debian and Ubuntu by apt-get."""

from __future__ import annotations

from pathlib import Path

from envsetup.console import Step, run_logged


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
