# SPDX-License-Identifier: Apache-2.0
"""Run processes: our nodes and bare nodes on the arm of the scenario `arm7`, commands to their end, busy loops."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from bench.figures import ROOT
from fjr_bringup.node_process import executable
from fjr_msgs_py.console.ros2 import discover_quickly
from fjr_msgs_py.scenarios import library

HOSTS = ("native", "events")
"""Values of the parameter `executor` of both nodes."""
PRIORITY = 50  # as in the scenario; used if the system allows it
GRACE = 5.0  # s
DOMAIN = "100"  # outside the ids used by the tests
MEASURING = """
import json, resource, subprocess, sys, time
began = time.perf_counter()
done = subprocess.run(sys.argv[1:], stdout=subprocess.PIPE, text=True)
seconds, used = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([done.returncode, done.stdout, seconds, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024]))
"""
"""Runs a command from a small process: the peak of a child is at least that of the process that started it."""


class Used(NamedTuple):
    """Output of a command; wall time [s], processor time [s] and largest resident memory [MB] of all its processes."""

    output: str
    seconds: float
    processor: float
    memory: float


def ros_environment() -> Mapping[str, str]:
    """Set the ROS environment variables of this process; return its environment."""
    os.environ.setdefault("ROS_DOMAIN_ID", DOMAIN)
    discover_quickly(locally=True)
    return os.environ


@contextmanager
def scenario_file(overrides: Mapping[str, Any] | None = None, name: str = "arm7") -> Iterator[Path]:
    """Write a scenario with changed parameters to a file; set the ROS environment variables."""
    ros_environment()
    with tempfile.TemporaryDirectory(prefix="fjr-bench-") as folder:
        path = Path(folder, "scenario.yaml")
        path.write_text(library.as_run(library.find(name), overrides or {})[0], encoding="utf-8")
        yield path


def plant(file: Path, *arguments: str) -> list[str]:
    """Return the command of the plant node."""
    return [str(executable("fjr_plant", "plant_node")), "--ros-args", "--params-file", str(file), *arguments]


def controller(file: Path, *arguments: str) -> list[str]:
    """Return the command of the controller node."""
    node = executable("fjr_controller", "controller_node")
    return [str(node), "--ros-args", "--params-file", str(file), *arguments]


def bare(kind: str, *arguments: str, priority: int = PRIORITY) -> list[str]:
    """Return the command of a bare node."""
    module = [sys.executable, "-m", "bench.bare", kind]
    return [*module, "--ros-args", *arguments, "-p", f"realtime_priority:={priority}"]


@contextmanager
def running(*commands: Sequence[str]) -> Iterator[list[int]]:
    """Run commands inside the block, yield their process ids; raise RuntimeError if one fails."""
    with ExitStack() as stack:
        yield [stack.enter_context(process(command)).pid for command in commands]


@contextmanager
def process(
    command: Sequence[str],
    stdout: int = subprocess.DEVNULL,
    quiet: bool = False,
    may_end: bool = False,
    cache: str = "",
) -> Iterator[subprocess.Popen[str]]:
    """Run a command inside the block, and end it by SIGINT; raise RuntimeError if it has ended before, unless it may.

    quiet: without its messages on stderr. cache: folder of compiled code, "" for that of the user.
    """
    options: dict[str, Any] = {"cwd": ROOT, "env": _environment(cache), "stdout": stdout, "text": True}
    options |= {"stderr": subprocess.DEVNULL} if quiet else {}
    with subprocess.Popen(command, **options, start_new_session=True) as started:
        try:
            yield started
            if started.poll() is not None and not may_end:
                name = Path(command[0]).name
                raise RuntimeError(f"{name} ended with {started.returncode}; expected it to be running")
        finally:
            started.send_signal(signal.SIGINT)
            try:
                started.wait(GRACE)
            except subprocess.TimeoutExpired:
                started.kill()


@contextmanager
def burning(count: int) -> Iterator[None]:
    """Keep the cores busy with ordinary processes inside the block."""
    with ExitStack() as stack:
        for _ in range(count):
            started = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(started.kill)
        yield


def used(*command: str, cache: str = "", longest: float | None = None) -> Used:
    """Run a command to its end, at most `longest` [s]; return what it used. Raise RuntimeError if it fails."""
    measuring = [sys.executable, "-S", "-c", MEASURING, *command]
    options: dict[str, Any] = {"cwd": ROOT, "env": _environment(cache), "stdout": subprocess.PIPE, "text": True}
    done = subprocess.run(measuring, **options, check=True, timeout=longest)
    code, *found = json.loads(done.stdout)
    if code:
        raise RuntimeError(f"{' '.join(command)} ended with {code}; expected 0")
    return Used(*found)


def _environment(cache: str) -> dict[str, str] | None:
    """Return the environment of a process with its own cache, without variables of the start-up hook of the wheels."""
    if not cache:
        return None
    env = {**os.environ, "XDG_CACHE_HOME": cache}
    if env.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None):
        env.pop("LD_LIBRARY_PATH", None)
    return env
