# SPDX-License-Identifier: Apache-2.0
"""Start our nodes and bare nodes as processes, on the arm of the scenario `arm7`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from bench.arm import ROOT, SCENARIO
from bench.start_up import DOMAIN
from fjr_bringup.runner.node_process import executable
from fjr_bringup.runner.run import set_ros_environment
from fjr_bringup.scenarios import library

PRIORITY = 50  # as in the scenario; used if the system allows it
GRACE = 5.0  # s


@contextmanager
def scenario_file(overrides: Mapping[str, Any] | None = None) -> Iterator[Path]:
    """Write the scenario with changed parameters to a file; set the ROS environment variables."""
    os.environ.setdefault("ROS_DOMAIN_ID", DOMAIN)
    set_ros_environment()
    with tempfile.TemporaryDirectory(prefix="fjr-bench-") as folder:
        path = Path(folder, "scenario.yaml")
        path.write_text(library.as_run(SCENARIO, overrides or {})[0], encoding="utf-8")
        yield path


def plant(file: Path, *arguments: str) -> list[str]:
    """Return the command of the plant node."""
    return _ours("fjr_plant", "plant_node", file, arguments)


def controller(file: Path, *arguments: str) -> list[str]:
    """Return the command of the controller node."""
    return _ours("fjr_controller", "controller_node", file, arguments)


def bare(kind: str, *arguments: str, priority: int = PRIORITY) -> list[str]:
    """Return the command of a bare node."""
    return _module("bench.bare", kind, arguments=(*arguments, "-p", f"realtime_priority:={priority}"))


def driver(*arguments: str) -> list[str]:
    """Return the command of the driver."""
    return _module("bench.driver", arguments=(*arguments, "-p", f"realtime_priority:={PRIORITY}"))


@contextmanager
def running(*commands: Sequence[str]) -> Iterator[list[int]]:
    """Run commands inside the block, yield their process ids; raise RuntimeError if one fails."""
    with ExitStack() as stack:
        yield [stack.enter_context(_running(command)) for command in commands]


def output(command: Sequence[str], longest: float) -> str:
    """Run a command to its end; return its output."""
    done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True, timeout=longest)
    return done.stdout


@contextmanager
def _running(command: Sequence[str]) -> Iterator[int]:
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, start_new_session=True) as process:
        try:
            yield process.pid
            if process.poll() is not None:
                raise RuntimeError(
                    f"{Path(command[0]).name} ended with {process.returncode}; expected it to be running"
                )
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(GRACE)
            except subprocess.TimeoutExpired:
                process.kill()


def _ours(package: str, name: str, file: Path, arguments: Sequence[str]) -> list[str]:
    return [str(executable(package, name)), "--ros-args", "--params-file", str(file), *arguments]


def _module(*command: str, arguments: Sequence[str]) -> list[str]:
    return [sys.executable, "-m", *command, "--ros-args", *arguments]
