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
from types import TracebackType

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
        self.title = title
        self.note = ""
        self._live = sys.stdout.isatty()
        self._open = True  # whether the cursor is behind the title
        self._stop = threading.Event()
        self._ticker = threading.Thread(target=self._refresh if self._live else self._report, daemon=True)

    def __enter__(self) -> Step:
        self._start = time.monotonic()
        if not self._live:
            print(f"{PREFIX} {self.title} ...", end="", flush=True)
        self._ticker.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._ticker.join()
        if self._live:
            print("\r\033[K", end="")
        if self._live or not self._open:
            print(f"{PREFIX} {self.title} ...", end="")
        outcome = "" if kind is None else "failed after "
        print(f" {outcome}{time.monotonic() - self._start:.1f} s", flush=True)

    def _line(self, longest: int) -> str:
        """Return title, elapsed time and note, in at most `longest` characters."""
        return f"{PREFIX} {self.title} ... {time.monotonic() - self._start:.0f} s  {self.note}"[:longest]

    def _refresh(self) -> None:
        while True:
            print("\r\033[K" + self._line(shutil.get_terminal_size().columns - 1), end="", flush=True)
            if self._stop.wait(0.5):
                return

    def _report(self) -> None:
        while not self._stop.wait(BEAT):
            print("\n" * self._open + self._line(LONGEST), flush=True)
            self._open = False


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
