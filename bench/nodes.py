# SPDX-License-Identifier: Apache-2.0
"""Run processes and read topics: our nodes, bare nodes on the arm of `arm7`, commands to their end, busy loops.

Topics are read in batches, with little load on the measured nodes.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from bench.figures import ROOT
from fjr_bringup.node_process import executable
from fjr_monitor.recording.bag import header_stamp
from fjr_msgs_py.console.ros2 import discover_quickly
from fjr_msgs_py.node.participant import own_node
from fjr_msgs_py.scenarios import library

HOSTS = ("native", "events")
"""Values of the parameter `executor` of both nodes."""
PRIORITY = 50  # as in the scenario; used if the system allows it
GRACE = 5.0  # s
DOMAIN = "100"  # outside the ids used by the tests
DEPTH = 5000
PAUSE = 0.05  # s between two reads of the queues
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


# Topics.


class Seen(NamedTuple):
    """A message: stamp and send time [ns], and its serialised data."""

    stamp: int
    sent: int
    data: bytes = b""


class Tap:
    """Context manager: a node that reads JointStates from its queues without an executor."""

    def __enter__(self) -> Tap:
        self._own = own_node("fjr_bench_tap")
        self.node = self._own.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._own.__exit__(None, None, None)

    def next(self, topic: str, longest: float) -> Seen:
        """Return one message, subscribing only for it; raise TimeoutError after `longest` [s]."""
        with self.listening([topic], longest) as heard:
            return heard.seen[0][0]

    @contextmanager
    def listening(self, topics: list[str], longest: float) -> Iterator[Heard]:
        """Listen to topics inside the block, which begins with the first message of the last of them."""
        subscribe, quality = self.node.create_subscription, QoSProfile(depth=DEPTH)
        subscriptions = [subscribe(JointState, topic, lambda _: None, quality, raw=True) for topic in topics]
        try:
            yield Heard(subscriptions, [[self._wait(subscription, longest)] for subscription in subscriptions])
        finally:
            for subscription in subscriptions:
                self.node.destroy_subscription(subscription)

    def _wait(self, subscription: Subscription, longest: float) -> Seen:
        end = perf_counter() + longest
        while (taken := next(waiting(subscription, JointState, raw=True), None)) is None:
            if perf_counter() > end:
                raise TimeoutError(f"{subscription.topic} was silent for {longest:g} s; expected a message")
            time.sleep(1e-3)
        return _seen(taken)


@dataclass(frozen=True)
class Heard:
    """What a tap hears: subscriptions, and their messages so far."""

    subscriptions: list[Subscription]
    seen: list[list[Seen]]

    def collect(self, seconds: float) -> None:
        """Read the queues for a time."""
        end = perf_counter() + seconds
        while perf_counter() < end:
            time.sleep(PAUSE)
            self.drain()

    def until(self, happened: Callable[[], object], longest: float, what: str) -> None:
        """Read the queues until `happened()`; raise TimeoutError after `longest` [s]."""
        end = perf_counter() + longest
        while not happened():
            if perf_counter() > end:
                raise TimeoutError(f"waited {longest:g} s for {what}")
            self.collect(PAUSE)

    def drain(self) -> None:
        """Empty the queues, which hold DEPTH messages."""
        for found, subscription in zip(self.seen, self.subscriptions, strict=True):
            found += map(_seen, waiting(subscription, JointState, raw=True))

    def messages(self) -> list[NDArray[np.int64]]:
        """Return stamps and send times (k, 2) [ns] of each topic."""
        return [np.array([each[:2] for each in found], dtype=np.int64).reshape(-1, 2) for found in self.seen]

    def values(self, k: int, *fields: str) -> NDArray[np.float64]:
        """Return these fields of the messages of the k-th topic, side by side."""
        messages = (deserialize_message(each.data, JointState) for each in self.seen[k])
        return np.array([np.concatenate([getattr(message, name) for name in fields]) for message in messages])


def waiting(subscription: Subscription, kind: Any, raw: bool = False) -> Iterator[tuple[Any, Any]]:
    """Take the messages of a kind, or their raw data, that wait in a queue, each with its times."""
    while (taken := subscription.handle.take_message(kind, raw)) is not None:
        yield taken


def _seen(taken: tuple[Any, Any]) -> Seen:
    data, known = taken
    return Seen(header_stamp(data), known["source_timestamp"], data)
