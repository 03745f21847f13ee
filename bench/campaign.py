# SPDX-License-Identifier: Apache-2.0
"""Monte-Carlo study of 10,000 runs of the paper's joint with model errors, against SciPy and MuJoCo."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from time import perf_counter, process_time
from timeit import timeit

import numpy as np

from bench.campaign_peers import NAMES, Peer, mujoco_peer, scipy_peer
from bench.figures import Figure
from bench.measure import one_core
from fjr_core import PAPER_GAINS, Sine, TrackingLaw, single_link
from fjr_core.simulation.batch import ClosedLoop, Draws

RUNS, DURATION, PERIOD, INNER_STEPS = 10_000, 5.0, 1e-3, 4
PART = 250
CORES = 2
ROUNDS = 5
RANGES = {
    "stiffness": (0.7, 1.3),
    "link_inertia": (0.8, 1.2),
    "gravity": (0.8, 1.2),
    "motor_inertia": (0.8, 1.2),
    "link_damping": (0.5, 2.0),
    "motor_damping": (0.5, 2.0),
}


def loop() -> ClosedLoop:
    """Return the closed loop of the paper's joint, k = 31, at 1 kHz."""
    robot = single_link(stiffness=31.0)
    law = TrackingLaw(robot, PAPER_GAINS, compile=True)
    x0 = robot.state([0.5], [0.5], [0.0], [0.0])
    return ClosedLoop(robot, law, Sine(1.0, 1.0), x0, DURATION, PERIOD, INNER_STEPS)


def draws(runs: int) -> Draws:
    """Draw six plant parameters for every run."""
    rng = np.random.default_rng(1)
    return Draws(runs, **{name: rng.uniform(*RANGES[name], runs) for name in NAMES})


def against_peers(runs: int = RUNS, rounds: int = ROUNDS) -> list[Figure]:
    """Measure the wall time of the study on two cores, and the speed-up over each peer on one core."""
    ours, drawn = loop(), draws(runs)
    ours.run(drawn.taken(range(2)))
    wall, busy = campaign(ours, drawn)
    some = {
        "ours": (lambda first: ours.run(drawn.taken(np.arange(first, first + 100) % runs)), 100),
        **_peers(ours, drawn),
    }
    times: dict[str, list[float]] = {name: [] for name in some}
    with one_core():
        for i in range(rounds):
            for name, (run, count) in some.items():
                times[name].append(timeit(partial(run, i * count), number=1) / count)
    each = {name: float(np.median(seconds)) for name, seconds in times.items()}
    name = f"campaign: {runs:,} runs of the paper's joint, 5 s at 1 kHz, on two cores"
    parts = {"processor time [s]": busy, "a run [ms]": 1e3 * each["ours"], "cores there": float(os.cpu_count() or 0)}
    figures = [Figure(name, wall, "s", bound=60, aim=20, parts=parts)]
    for name in ("solve_ivp", "MuJoCo"):
        parts = {
            f"{name}, each run [ms]": 1e3 * each[name],
            f"{name}, {runs:,} runs on one core [h]": each[name] * runs / 3600,
        }
        faster = float(np.median(np.array(times[name]) / np.array(times["ours"])))
        figures.append(Figure(f"campaign, times faster than {name}", faster, "x", bound=10, at_least=True, parts=parts))
    return figures


def campaign(ours: ClosedLoop, drawn: Draws) -> tuple[float, float]:
    """Run the study in two threads; return wall time and processor time [s]."""
    parts = [slice(begin, begin + PART) for begin in range(0, drawn.runs, PART)]
    start, before = perf_counter(), process_time()
    with ThreadPoolExecutor(CORES) as pool:
        outcomes = list(pool.map(lambda part: ours.run(drawn.taken(part)), parts))
    seconds = perf_counter() - start, process_time() - before
    if not all(outcome.stable.all() for outcome in outcomes):
        raise ArithmeticError("a run was lost; expected all to be stable")
    return seconds


def _peers(ours: ClosedLoop, drawn: Draws) -> dict[str, tuple[Callable[[int], object], int]]:
    def of(peer: Peer, count: int) -> tuple[Callable[[int], object], int]:
        return lambda first: [peer(ours, drawn, (first + i) % drawn.runs) for i in range(count)], count

    return {"solve_ivp": of(scipy_peer, 1), "MuJoCo": of(mujoco_peer, 5)}
