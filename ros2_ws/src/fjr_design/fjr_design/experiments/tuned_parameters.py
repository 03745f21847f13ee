# SPDX-License-Identifier: Apache-2.0
"""The law of parameter values, tuned to equal bandwidth with v-dPBC."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fjr_core.config import law
from fjr_core.config.builders import sample_period
from fjr_core.config.gains import gains
from fjr_core.config.parameter import Value, Values, vector
from fjr_core.config.reference import reference
from fjr_core.config.robot import robot
from fjr_core.model.robot import Robot
from fjr_core.stability.linearization import rest_position

from ..tuning.equal_bandwidth import BaselineTarget, Tuning, tune


def tuning(values: Values) -> Tuning:
    """Return the law of the values tuned to equal bandwidth, and the result of tuning.

    Raises ParameterError or GainsError.
    """
    relevant = ("robot.", "gains.", "reference.", law.TYPE.name, law.INITIAL_ERROR.name, law.SAMPLE_RATE.name, "joints")
    return _tuned(tuple(sorted((name, value) for name, value in values.items() if name.startswith(relevant))))


@lru_cache(maxsize=8)
def _tuned(items: tuple[tuple[str, Value], ...]) -> Tuning:
    values = dict(items)
    return tune(str(values[law.TYPE.name]), baseline_target(values, robot(values)))


def baseline_target(values: Values, robot: Robot) -> BaselineTarget:
    """Return the tuning target: v-dPBC with gains.* along the reference, starting at rest with law.start_error."""
    motion = reference(values, robot.n)
    error = np.tile(vector(values, law.INITIAL_ERROR.name, robot.n), 2)
    position = rest_position(robot, np.asarray(motion.jets(0.0))[0]) + error
    start = position, np.zeros(2 * robot.n)
    return BaselineTarget(robot, motion, gains(values, robot.n), start, sample_period(values))
