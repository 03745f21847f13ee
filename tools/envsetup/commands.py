# SPDX-License-Identifier: Apache-2.0
"""How commands of the set-up run: one line with its time, one sentence an error, the output in a log."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

PREFIX = "[setup]"
TAIL_LINES = 25
BEAT = 2.0  # s; no command is silent for longer
LONGEST = 160  # characters of a passing line that is not on a terminal


class SetupError(Exception):
    """An error for the user: one sentence, optionally with `details`."""

    def __init__(self, message: str, details: str = "") -> None:
        super().__init__(message)
        self.details = details


def say(text: str, passing: bool = False) -> None:
    """Print one line of the set-up; on a terminal the next line takes the place of a passing one."""
    line = f"{PREFIX} {text}"
    if not sys.stdout.isatty():
        print(line[:LONGEST] if passing else line, flush=True)
    elif passing:
        print(f"\r\033[K{line[: shutil.get_terminal_size().columns - 1]}", end="", flush=True)
    else:
        print(f"\r\033[K{line}", flush=True)


def run(
    title: str, command: Sequence[str], log: Path, env: dict[str, str], failure: str, cwd: Path | None = None
) -> None:
    """Run a command with its output in `log`; say its title, now and then its latest line, and at the end its time.

    Raise SetupError(failure) with the last lines unless it exits 0.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    begun = time.monotonic()
    with log.open("a", encoding="utf-8") as output:
        print(f"$ {' '.join(command)}", file=output, flush=True)
        try:
            process = subprocess.Popen(
                command, cwd=cwd, env=env, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT
            )
        except OSError as error:
            raise SetupError(f"{failure}: {error}") from error
        with process:
            try:
                say(f"{title} ...", passing=True)
                while process.poll() is None:
                    try:
                        process.wait(BEAT)
                    except subprocess.TimeoutExpired:
                        latest = "".join(last_lines(log, 1))
                        say(f"{title} ... {time.monotonic() - begun:.0f} s  {latest}", passing=True)
            except KeyboardInterrupt:
                process.terminate()  # the next set-up must not find it at work
                process.wait()
                raise
    seconds = f"{time.monotonic() - begun:.1f} s"
    if process.returncode != 0:
        say(f"{title} ... failed after {seconds}")
        reason = f"(exit code {process.returncode}; the whole output is in {log})"
        raise SetupError(f"{failure} {reason}", "\n".join(last_lines(log, TAIL_LINES)))
    say(f"{title} ... {seconds}")


def last_lines(log: Path, count: int) -> list[str]:
    """Return the last lines of a log."""
    return log.read_text(encoding="utf-8", errors="replace").splitlines()[-count:]


def clean_environment(sourced_ros: bool) -> dict[str, str]:
    """Return the environment without variables that mislead pip, colcon or the start-up hook of the wheels.

    The hook of the ROS wheels re-executes Python once with its own LD_LIBRARY_PATH and leaves a guard
    variable behind, which would keep the Python of another environment from finding its libraries.
    """
    env = dict(os.environ)
    if env.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None):
        env.pop("LD_LIBRARY_PATH", None)
    misleading = ["PYTHONHOME", "VIRTUAL_ENV"]
    misleading += ["PIP_TARGET", "PIP_PREFIX", "PIP_ROOT", "PIP_CONSTRAINT", "PIP_REQUIREMENT"]
    if not sourced_ros:
        misleading += ["PYTHONPATH", "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH"]
    for name in misleading:
        env.pop(name, None)
    env["COLCON_DEFAULTS_FILE"] = os.devnull  # else the user's defaults, such as merge-install, change the build
    env.update(PYTHONNOUSERSITE="1", PIP_USER="0", PIP_NO_INPUT="1", PIP_DISABLE_PIP_VERSION_CHECK="1")
    return env
