# SPDX-License-Identifier: Apache-2.0
"""Closed loop without ROS: speed relative to real time, at a converged integration step."""

from __future__ import annotations

from timeit import timeit

import numpy as np

from bench.arm import Arm, arm7
from bench.figures import Figure
from bench.measure import one_core
from fjr_core import simulate
from fjr_core.numerics.checks import Array

DURATION = 3.0  # s
TOLERANCE = 1e-6  # rad; largest change when the step is halved
MOST_STEPS = 64
REPEATS = 9


def times_real_time() -> list[Figure]:
    """Measure law and plant of the scenario at its sample period."""
    arm = arm7()
    steps, change = fine_enough(arm)
    with one_core():
        walls = [timeit(lambda: positions(arm, steps), number=1) for _ in range(REPEATS)]
    parts = {
        "inner step [ms]": 1e3 * arm.scenario.sample_period / steps,
        "halving it changes q by [rad]": change,
        "spread [%]": 100 * float(np.ptp(walls) / np.median(walls)),
    }
    value = DURATION / float(np.median(walls))
    return [Figure("closed loop, 7 joints, 1 kHz", value, "x real time", bound=60, aim=100, at_least=True, parts=parts)]


def fine_enough(arm: Arm) -> tuple[int, float]:
    """Return the fewest steps per sample (a power of two), and the change of positions [rad] with twice as many."""
    steps, change, coarse = 1, np.inf, positions(arm, 1)
    while steps <= MOST_STEPS:
        fine = positions(arm, 2 * steps)
        change = float(np.max(np.abs(fine - coarse)))
        if change < TOLERANCE:
            return steps, change
        steps, coarse = 2 * steps, fine
    raise ArithmeticError(f"{MOST_STEPS} steps a sample leave {change:.1e} rad; expected less than {TOLERANCE}")


def positions(arm: Arm, steps: int) -> Array:
    """Return q_l and q_m (k, 2n) at every sample [rad]."""
    period = arm.scenario.sample_period
    run = simulate(
        arm.plant, arm.law, arm.scenario.reference, arm.scenario.x0, DURATION, period, inner_step=period / steps
    )
    return run.x[:, : 2 * arm.robot.n]
