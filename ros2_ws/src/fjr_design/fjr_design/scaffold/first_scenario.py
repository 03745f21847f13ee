# SPDX-License-Identifier: Apache-2.0
"""Complete a robot file to a scenario: a first motion, gains, integrator steps and the limits of the robot."""

from __future__ import annotations

from typing import Any

import numpy as np

from fjr_core.config.controller import FROM_ROBOT
from fjr_core.config.law import gain_values
from fjr_core.config.scenario import Scenario
from fjr_design.scaffold.proposal import proposal_of


def first_values(loaded: Scenario) -> dict[str, Any]:
    """Return the parameters, by name, that make a robot file a scenario; loaded: the file as a scenario.

    Raises TrajectoryError or GainsError if there is no first motion, or no gains within reach.
    """
    robot = loaded.robot
    found = proposal_of(robot, loaded.joints, loaded.name)
    rows = {name: np.broadcast_to(getattr(found.motion, name), robot.n) for name in ("amplitude", "frequency")}
    rows |= {name: np.broadcast_to(getattr(found.motion, name), robot.n) for name in ("offset", "phase")}
    return {
        "reference.type": "sine",
        **{f"reference.{name}": [float(entry) for entry in entries] for name, entries in rows.items()},
        **gain_values(found.gains.gains, robot.n),
        "initial_link_position": found.q_l.tolist(),
        "initial_motor_position": found.q_m.tolist(),
        "inner_steps": found.inner_steps,
        **({FROM_ROBOT.name: True} if robot.limits is not None else {}),
    }
