# SPDX-License-Identifier: Apache-2.0
"""The tuning target of a scenario, v-dPBC with its gains, and the law of its parameters tuned to equal bandwidth."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fjr_core.config import law
from fjr_core.config.law import gains, sample_period
from fjr_core.config.parameter import Value, Values, vector
from fjr_core.config.reference import reference
from fjr_core.config.robot import robot
from fjr_core.config.scenario import Scenario
from fjr_core.stability.linearization import rest_position

from .equal_bandwidth import BaselineTarget, Tuning, tune


def baseline_target(scenario: Scenario) -> BaselineTarget:
    """Return the target of the rule of equal bandwidth for robot, reference, gains and start of a scenario."""
    robot, n = scenario.robot, scenario.robot.n
    start = scenario.x0[: 2 * n], np.hstack(robot.velocities(scenario.x0))
    return BaselineTarget(robot, scenario.reference, scenario.gains, start, scenario.sample_period)


def tuning(values: Values) -> Tuning:
    """Return the law of parameter values tuned to equal bandwidth, and the result of tuning.

    The target is v-dPBC with gains.* along the reference, starting at rest with law.start_error. Raises ParameterError
    or GainsError.
    """
    relevant = ("robot.", "gains.", "reference.", law.TYPE.name, law.INITIAL_ERROR.name, law.SAMPLE_RATE.name, "joints")
    return _tuned(tuple(sorted((name, value) for name, value in values.items() if name.startswith(relevant))))


@lru_cache(maxsize=8)
def _tuned(items: tuple[tuple[str, Value], ...]) -> Tuning:
    values = dict(items)
    arm = robot(values)
    motion = reference(values, arm.n)
    error = np.tile(vector(values, law.INITIAL_ERROR.name, arm.n), 2)
    start = rest_position(arm, np.asarray(motion.jets(0.0))[0]) + error, np.zeros(2 * arm.n)
    target = BaselineTarget(arm, motion, gains(values, arm.n), start, sample_period(values))
    return tune(str(values[law.TYPE.name]), target)
