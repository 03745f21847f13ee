# SPDX-License-Identifier: Apache-2.0
"""The tuning target of a scenario: v-dPBC with its gains, at its start."""

from __future__ import annotations

import numpy as np

from fjr_core.config.scenario import Scenario

from ..tuning.equal_bandwidth import BaselineTarget


def baseline_target(scenario: Scenario) -> BaselineTarget:
    """Return the target of the rule of equal bandwidth for robot, reference, gains and start of a scenario."""
    robot, n = scenario.robot, scenario.robot.n
    start = scenario.x0[: 2 * n], np.hstack(robot.velocities(scenario.x0))
    return BaselineTarget(robot, scenario.reference, scenario.gains, start, scenario.sample_period)
