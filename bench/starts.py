# SPDX-License-Identifier: Apache-2.0
"""Start-up: of the law, of the controller node, of `fjr`, and whether `arm7` starts in real time by `fjr run`.

Times until the first effort are taken with an empty and a filled cache. Starts in real time count from the first effort
on: stopped or not, answers before the next state; quiet and beside busy processes, with the permission for real-time
priority and as a user without it. `machine` is the largest lateness meanwhile of a thread of high priority that only
sleeps (bench/machine.py). `machine awake` counts the states in whose time that thread woke at most STALL late on both
cores; the bound holds for all states.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from bench.figures import Figure
from bench.machine import watched
from bench.nodes import Tap, burning, controller, plant, process, ros_environment, used
from fjr_core.config.scenario import load_scenario
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.recording.files import Topic
from fjr_monitor.recording.run import Recording
from fjr_monitor.recording.signals import ANSWERS, RunSignals
from fjr_msgs_py import names
from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.scenarios.library import find

COLD_REPEATS, WARM_REPEATS, NODE_REPEATS, COMMAND_REPEATS = 3, 3, 11, 5
LONGEST = 120.0  # s; timeout of each wait
SCENARIO = find("arm7")
FIRST_EFFORT = """
import sys
from fjr_core import TrackingLaw
from fjr_core.config.scenario import load_scenario
scenario = load_scenario(sys.argv[1])
law = TrackingLaw(scenario.robot, scenario.gains, compile=True)
print(law.command(scenario.x0, scenario.reference.jets(0.0)).tolist(), flush=True)
"""
STATES = 1000  # from the first that is answered
DURATION = 2.5  # s of each run
LARGEST_ERROR = 2e-4  # rad, of any joint after 2 s
STALL = 0.5  # ms that the machine itself is late; half a period of the states
MOST = 50  # starts in a setting
MEMORY = 8 << 20  # bytes that an ordinary user may lock
ORDINARY = (
    *("setpriv", "--bounding-set=-sys_nice,-ipc_lock,-sys_resource", "--inh-caps=-all"),
    *("prlimit", "--rtprio=0:0", "--nice=0:0", f"--memlock={MEMORY}:{MEMORY}"),
)
"""What takes the permissions from a command that root may have: real-time priority, nice, locked memory."""


def law() -> list[Figure]:
    """Measure the start of the law, compiled and from the cache."""
    cold, warm = [], []
    for _ in range(COLD_REPEATS):
        with TemporaryDirectory(prefix="fjr-bench-") as cache:
            cold.append(_first_effort(cache))
            warm += [_first_effort(cache) for _ in range(WARM_REPEATS)]
    return [
        _seconds("URDF to first effort, nothing cached", cold, bound=10.0),
        _seconds("URDF to first effort, from the cache", warm, bound=1.0),
    ]


def node() -> list[Figure]:
    """Measure the controller node with a cached law until its first command; the plant is running."""
    ros_environment()
    with TemporaryDirectory(prefix="fjr-bench-") as cache:
        _first_command(cache)
        seconds = [_first_command(cache) for _ in range(NODE_REPEATS)]
    return [_seconds("controller node, spawn to first command", seconds, bound=0.5)]


def command() -> list[Figure]:
    """Measure the processor time of `fjr` and the nodes that it starts, with filled caches."""
    ros_environment()
    with TemporaryDirectory(prefix="fjr-bench-") as folder:
        run = ("run", "paper_k31", "--lockstep", "--duration", "0.2", "--output", folder)
        _processor_time(folder, *run)  # fills the cache
        lines = {
            "fjr --help": (("--help",), 0.4),
            "fjr scenarios": (("scenarios",), 0.4),
            "fjr run, 0.2 s in lock-step": (run, 4.0),
            "fjr run --no-report, 0.2 s in lock-step": ((*run, "--no-report"), 4.0),
        }
        return [
            _seconds(f"{name}, processor time", [_processor_time(folder, *line) for _ in range(COMMAND_REPEATS)], bound)
            for name, (line, bound) in lines.items()
        ]


def _processor_time(cache: str, *arguments: str) -> float:
    """Return the time [s] that the processors spend on `fjr` and its nodes: unlike that of a clock, for any load."""
    return used("fjr", *arguments, cache=cache, longest=LONGEST).processor


def _first_effort(cache: str) -> float:
    return used(sys.executable, "-c", FIRST_EFFORT, str(SCENARIO), cache=cache, longest=LONGEST).seconds


def _first_command(cache: str) -> float:
    with process(plant(SCENARIO), cache=cache), Tap() as tap:
        tap.next(names.JOINT_STATES, LONGEST)
        start = perf_counter()
        with process(controller(SCENARIO), cache=cache):
            tap.next(names.JOINT_COMMANDS, LONGEST)
            return perf_counter() - start


def _seconds(name: str, seconds: list[float], bound: float) -> Figure:
    parts = {"least [s]": min(seconds), "most [s]": max(seconds)}
    return Figure(name, float(np.median(seconds)), "s", bound=bound, parts=parts)


@dataclass(frozen=True)
class Setting:
    """Starts in one setting; busy: processes beside them; bound: least share [%] of answers before the next state."""

    name: str
    count: int
    busy: int
    ordinary: bool
    bound: float


SETTINGS = (
    Setting("quiet", 50, 0, False, 99.8),
    Setting("beside six busy processes", 20, 6, False, 99.0),
    Setting("quiet, no real-time priority", 50, 0, True, 99.5),
    Setting("beside two busy processes, no real-time priority", 20, 2, True, 95.0),
)


@dataclass(frozen=True)
class Start:
    """Outcome of a start. in_time: share [%] of STATES answered before the next; wait: longest for an effort [ms].

    late (k, 2): when each state that was not answered before the next was sent, and when the next was [ns].
    """

    stopped: bool
    in_time: float
    wait: float
    error: float
    late: NDArray[np.int64]

    def awake(self, stalls: NDArray[np.int64]) -> float:
        """Return in_time without the states whose time a stall (k, 2) [ns] of the machine overlaps."""
        (sent, following), (begin, end) = self.late.T[..., None], stalls.T
        of_machine = np.any((begin < following) & (sent < end), axis=1).sum()
        return min(100.0, self.in_time * STATES / (STATES - of_machine))


def arm7(most: int = MOST) -> list[Figure]:
    """Start the arm in all settings, at most so many times in each."""
    return [figure for each in SETTINGS for figure in _figures(each, min(most, each.count))]


def _figures(setting: Setting, count: int) -> Iterator[Figure]:
    with burning(setting.busy), watched() as late:
        bar = tqdm(range(count), desc=setting.name, disable=not sys.stderr.isatty())
        starts = [_start(setting.ordinary) for _ in bar]
    stalls = np.array([(at - 1_000_000 * each, at) for each, at in late if each > STALL], dtype=np.int64).reshape(-1, 2)
    shares, waits = (np.array([getattr(each, name) for each in starts]) for name in ("in_time", "wait"))
    stopped = sum(each.stopped for each in starts)
    yield Figure(f"starts of arm7 stopped, {setting.name}", stopped, "", bound=0, parts={"starts": count})
    yield Figure(
        f"first {STATES} states answered before the next, worst start, {setting.name}",
        float(shares.min()),
        "%",
        bound=setting.bound,
        at_least=True,
        parts={"median [%]": float(np.median(shares)), "machine awake [%]": min(each.awake(stalls) for each in starts)},
    )
    parts = {"median [ms]": float(np.median(waits)), "machine [ms]": max(late).late}
    yield Figure(f"longest wait for an effort, worst start, {setting.name}", float(waits.max()), "ms", parts=parts)
    if not setting.busy and not setting.ordinary:
        errors = np.array([each.error for each in starts])
        name, parts = "arm7 over ROS in real time, largest error after 2 s", {"most [rad]": float(errors.max())}
        yield Figure(name, float(np.median(errors)), "rad", bound=LARGEST_ERROR, parts=parts)


def _start(ordinary: bool) -> Start:
    with TemporaryDirectory(prefix="fjr-bench-") as folder:
        run = ("fjr", "run", "arm7", "--no-report", "--duration", str(DURATION), "--output", folder)
        command = [*(ORDINARY if ordinary else ()), *run]
        done = subprocess.run(command, env=ros_environment(), capture_output=True, text=True, timeout=LONGEST)
        report = Path(folder, "arm7", "report.json")
        if done.returncode not in set(Exit) or not report.is_file():
            raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}\n{done.stdout}{done.stderr}")
        found = json.loads(report.read_text(encoding="utf-8"))
        run_of_bag = Recording(read_bag(Path(folder, "arm7", "bag")), load_scenario(SCENARIO))
        share, wait, late = answers(run_of_bag.signals, run_of_bag.bag.topic(ANSWERS))
    error = (found["tracking"] or {}).get("max_error_after_2s_rad")
    return Start(found["status"] == "stopped", share, wait, np.inf if error is None else error, late)


def answers(run: RunSignals, commands: Topic) -> tuple[float, float, NDArray[np.int64]]:
    """Return the share [%] of the first STATES answered before the next one, the longest wait for an effort [ms], late.

    late (k, 2): when the other states, and the next ones, were sent [ns]. The first state is the first that is
    answered. A run that ends early leaves the rest unanswered. A command that only the recorder lost does not count.
    """
    sent, sending = run.sent[: STATES + 1], commands.publish_time
    answered, spans = run.answered[: len(sent) - 1], np.column_stack([sent[:-1], sent[1:]])
    early = (answered >= 0) & (answered < sent[1:])
    waits = sending[np.minimum(np.searchsorted(sending, sent[:-1]), len(sending) - 1)] - sent[:-1]
    share = early.sum() / (STATES - (commands.lost or 0))
    return 100 * min(1.0, share), 1e-6 * float(waits.max()), spans[~early]
