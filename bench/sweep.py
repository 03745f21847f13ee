# SPDX-License-Identifier: Apache-2.0
"""Monte-Carlo study of 10,000 runs of the paper's joint with model errors, against SciPy and MuJoCo.

The peers simulate one run after the other as typical SciPy and MuJoCo code does; both call the compiled law.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from math import sin
from time import perf_counter, process_time
from timeit import timeit

import mujoco
import numpy as np
from scipy.integrate import solve_ivp

from bench.arm import mujoco_spec
from bench.figures import Figure, one_core
from fjr_core import PAPER_GAINS, Sine, TrackingLaw, single_link
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_design.batch import ClosedLoop, Draws

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
    return Draws(runs, **{name: rng.uniform(*RANGES[name], runs) for name in RANGES})


def against_peers(runs: int = RUNS, rounds: int = ROUNDS) -> list[Figure]:
    """Measure the wall time of the study on two cores, and the speed-up over each peer on one core."""
    ours, drawn = loop(), draws(runs)
    ours.run(drawn.taken(range(2)))
    wall, busy = sweep(ours, drawn)
    some: dict[str, tuple[Callable[[Sequence[int]], object], int]] = {
        "ours": (lambda chosen: ours.run(drawn.taken(np.array(chosen))), 100),
        "solve_ivp": (lambda chosen: [scipy_peer(ours, drawn, run) for run in chosen], 1),
        "MuJoCo": (lambda chosen: [mujoco_peer(ours, drawn, run) for run in chosen], 5),
    }
    times: dict[str, list[float]] = {name: [] for name in some}
    with one_core():
        for i in range(rounds):
            for name, (run, count) in some.items():
                chosen = [(i * count + k) % runs for k in range(count)]
                times[name].append(timeit(partial(run, chosen), number=1) / count)
    each = {name: float(np.median(seconds)) for name, seconds in times.items()}
    name = f"sweep: {runs:,} runs of the paper's joint, 5 s at 1 kHz, on two cores"
    parts = {"processor time [s]": busy, "a run [ms]": 1e3 * each["ours"], "cores there": float(os.cpu_count() or 0)}
    figures = [Figure(name, wall, "s", bound=60, aim=20, parts=parts)]
    for name in ("solve_ivp", "MuJoCo"):
        parts = {
            f"{name}, each run [ms]": 1e3 * each[name],
            f"{name}, {runs:,} runs on one core [h]": each[name] * runs / 3600,
        }
        faster = float(np.median(np.array(times[name]) / np.array(times["ours"])))
        figures.append(Figure(f"sweep, times faster than {name}", faster, "x", bound=10, at_least=True, parts=parts))
    return figures


def sweep(ours: ClosedLoop, drawn: Draws) -> tuple[float, float]:
    """Run the study in two threads; return wall time and processor time [s]."""
    parts = [slice(begin, begin + PART) for begin in range(0, drawn.runs, PART)]
    start, before = perf_counter(), process_time()
    with ThreadPoolExecutor(CORES) as pool:
        outcomes = list(pool.map(lambda part: ours.run(drawn.taken(part)), parts))
    seconds = perf_counter() - start, process_time() - before
    if not all(outcome.stable.all() for outcome in outcomes):
        raise ArithmeticError("a run was lost; expected all to be stable")
    return seconds


def scipy_peer(loop: ClosedLoop, draws: Draws, run: int) -> float:
    """Simulate a run by solve_ivp with default method and tolerances over each sample; return the RMS error [rad]."""
    M_l, load, M_m, K, D_l, D_m = numbers(loop.robot, draws, run)
    period = loop.sample_period

    def follow(x: Array, u: float) -> Array:
        def derivative(_t: float, x: Array) -> tuple[float, float, float, float]:
            q_l, q_m, dq_l, dq_m = x
            spring = K * (q_m - q_l)
            return dq_l, dq_m, (spring - D_l * dq_l - load * sin(q_l)) / M_l, (u - spring - D_m * dq_m) / M_m

        return np.asarray(solve_ivp(derivative, (0.0, period), x).y[:, -1])

    return _tracked(loop, follow)


def mujoco_peer(loop: ClosedLoop, draws: Draws, run: int) -> float:
    """Simulate a run by mj_step, all steps of a sample in one call; return the RMS error [rad]."""
    M_l, load, M_m, K, D_l, D_m = numbers(loop.robot, draws, run)
    joint = single_link(K, M_l, load, M_m, D_l, D_m)
    model = mujoco_spec(joint, loop.sample_period / loop.inner_steps).compile()
    data, first = mujoco.MjData(model), [True]

    def follow(x: Array, u: float) -> Array:
        if first:
            data.qpos[:], data.qvel[:] = x[:2], x[2:]
            first.clear()
        data.qfrc_applied[1] = u
        mujoco.mj_step(model, data, nstep=loop.inner_steps)
        x[:2], x[2:] = data.qpos, data.qvel
        return x

    return _tracked(loop, follow)


def numbers(robot: Robot, draws: Draws, run: int) -> Iterator[float]:
    """Yield M_l, m g l, M_m, K, D_l and D_m of a run."""
    for name, nominal in {
        "link_inertia": robot.M_l([0.0]),
        "gravity": robot.grad_P_l([np.pi / 2]),
        "motor_inertia": robot.M_m,
        "stiffness": robot.K,
        "link_damping": robot.D_l,
        "motor_damping": robot.D_m,
    }.items():
        yield float(nominal.item() * np.asarray(draws.values[name])[run])


def _tracked(loop: ClosedLoop, follow: Callable[[Array, float], Array]) -> float:
    """Run the loop; follow: (q_l, q_m, dq_l, dq_m) and held effort -> state one sample later."""
    assert isinstance(loop.law, TrackingLaw)
    samples = round(loop.duration / loop.sample_period)
    table = loop.reference.jets(loop.sample_period * np.arange(samples + 1))
    q = np.asarray(loop.x0)[:2]
    x = np.concatenate([q, *loop.robot.velocities(loop.x0)])
    error = np.empty(samples + 1)
    for k in range(samples + 1):
        error[k] = x[0] - table[k, 0, 0]
        if k < samples:
            x = follow(x, loop.law.measured_command(x[:2], x[2:], table[k])[0][0])
    after = error[round(loop.settle_after / loop.sample_period) :]
    return float(np.sqrt(np.mean(after**2)))
