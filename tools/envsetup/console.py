# SPDX-License-Identifier: Apache-2.0
"""Output of the set-up: one line per step with its time, one sentence per error, details in a log."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path

PREFIX = "[setup]"
TAIL_LINES = 25
BEAT = 2.0  # s; no step is silent for longer
LONGEST = 160  # characters of a line that is not on a terminal


class SetupError(Exception):
    """An error for the user: one sentence, optionally with `details`."""

    def __init__(self, message: str, details: str = "") -> None:
        super().__init__(message)
        self.details = details


def say(text: str) -> None:
    """Print one line of the set-up."""
    print(f"{PREFIX} {text}", flush=True)


class Step:
    """`with Step("colcon build"): ...` prints the title at once and the elapsed seconds at the end.

    Meanwhile it prints the elapsed time and the latest line of the running command: on a terminal in place, elsewhere
    as a line every BEAT.
    """

    def __init__(self, title: str) -> None:
        self.title, self.note = title, ""
        self._live, self._stop = sys.stdout.isatty(), threading.Event()
        self._ticker = threading.Thread(target=self._report, daemon=True)

    def __enter__(self) -> Step:
        self._start = time.monotonic()
        self._print("", end="" if self._live else "\n")
        self._ticker.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._stop.set()
        self._ticker.join()
        self._print(f"{'' if kind is None else 'failed after '}{time.monotonic() - self._start:.1f} s")

    def _report(self) -> None:
        while not self._stop.wait(0.5 if self._live else BEAT):
            self._print(f"{time.monotonic() - self._start:.0f} s  {self.note}", end="" if self._live else "\n")

    def _print(self, state: str, end: str = "\n") -> None:
        longest = shutil.get_terminal_size().columns - 1 if self._live else LONGEST
        line = f"{PREFIX} {self.title} ... {state}"[:longest]
        print(f"\r\033[K{line}" if self._live else line, end=end, flush=True)


def run_logged(
    command: Sequence[str],
    log: Path,
    env: dict[str, str],
    step: Step,
    cwd: Path | None = None,
    failure: str = "",
) -> None:
    """Run a command with its output in `log`; SetupError(failure) with the last lines unless it exits 0."""
    log.parent.mkdir(parents=True, exist_ok=True)
    tail: deque[str] = deque(maxlen=TAIL_LINES)
    with log.open("a", encoding="utf-8") as sink:
        sink.write(f"$ {' '.join(command)}\n")
        sink.flush()
        try:
            process = subprocess.Popen(
                command,
                cwd=cwd,
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
        except OSError as error:
            raise SetupError(f"{failure or command[0]}: {error}") from error
        with process:
            assert process.stdout is not None
            for raw in process.stdout:
                line = raw.decode(errors="replace").rstrip()
                sink.write(line + "\n")
                tail.append(line)
                step.note = line.strip()
    if process.returncode != 0:
        reason = f"(exit code {process.returncode}; the whole output is in {log})"
        raise SetupError(f"{failure or command[0] + ' failed'} {reason}", "\n".join(tail))


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
    env.update(PYTHONNOUSERSITE="1", PIP_USER="0", PIP_NO_INPUT="1", PIP_DISABLE_PIP_VERSION_CHECK="1")
    return env
