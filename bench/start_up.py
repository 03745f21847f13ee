# SPDX-License-Identifier: Apache-2.0
"""Start-up time to the first effort, with empty and filled cache and of the controller node, and of `fjr`."""

from __future__ import annotations

import sys
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from bench.figures import Figure
from bench.nodes import controller, plant, process, ros_environment, used
from bench.tap import Tap
from fjr_msgs_py import names
from fjr_msgs_py.scenarios.library import find

COLD_REPEATS, WARM_REPEATS, NODE_REPEATS, COMMAND_REPEATS = 3, 3, 11, 5
LONGEST = 60.0  # s
SCENARIO = find("arm7")
FIRST_EFFORT = """
import sys
from fjr_core import TrackingLaw
from fjr_core.config.scenario import load_scenario
scenario = load_scenario(sys.argv[1])
law = TrackingLaw(scenario.robot, scenario.gains, compile=True)
print(law.command(scenario.x0, scenario.reference.jets(0.0)).tolist(), flush=True)
"""


def library() -> list[Figure]:
    """Measure the start of the law, compiled and from the cache."""
    cold, warm = [], []
    for _ in range(COLD_REPEATS):
        with TemporaryDirectory(prefix="fjr-bench-") as cache:
            cold.append(_first_effort(cache))
            warm += [_first_effort(cache) for _ in range(WARM_REPEATS)]
    return [
        _figure("URDF to first effort, nothing cached", cold, bound=10.0),
        _figure("URDF to first effort, from the cache", warm, bound=1.0),
    ]


def node() -> list[Figure]:
    """Measure the controller node with a cached law until its first command; the plant is running."""
    ros_environment()
    with TemporaryDirectory(prefix="fjr-bench-") as cache:
        _first_command(cache)
        seconds = [_first_command(cache) for _ in range(NODE_REPEATS)]
    return [_figure("controller node, spawn to first command", seconds, bound=0.5)]


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
            _figure(f"{name}, processor time", [_processor_time(folder, *line) for _ in range(COMMAND_REPEATS)], bound)
            for name, (line, bound) in lines.items()
        ]


def _processor_time(cache: str, *arguments: str) -> float:
    """Return the time [s] that the processors spend on `fjr` and its nodes: unlike that of a clock, for any load."""
    return used("fjr", *arguments, cache=cache, longest=2 * LONGEST).processor


def _first_effort(cache: str) -> float:
    return used(sys.executable, "-c", FIRST_EFFORT, str(SCENARIO), cache=cache, longest=LONGEST).seconds


def _first_command(cache: str) -> float:
    with process(plant(SCENARIO), cache=cache), Tap() as tap:
        tap.next(names.JOINT_STATES, LONGEST)
        start = perf_counter()
        with process(controller(SCENARIO), cache=cache):
            tap.next(names.JOINT_COMMANDS, LONGEST)
            return perf_counter() - start


def _figure(name: str, seconds: list[float], bound: float) -> Figure:
    parts = {"least [s]": min(seconds), "most [s]": max(seconds)}
    return Figure(name, float(np.median(seconds)), "s", bound=bound, parts=parts)
