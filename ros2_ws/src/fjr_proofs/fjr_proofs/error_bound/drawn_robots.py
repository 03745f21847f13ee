# SPDX-License-Identifier: Apache-2.0
"""Simulate robots drawn from stated errors: an estimate of the tracking error where no bound is proven.

Of k independent values the largest exceeds their quantile of order p with probability 1 - p^k: 95 % for p = 0.99 and
k = 299. S. S. Wilks, "Determination of sample sizes for setting tolerance limits", Ann. Math. Statist. 12, 1941.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fjr_core.config.scenario import Scenario
from fjr_core.motions.inverse_dynamics import inverse_dynamics
from fjr_core.numerics.checks import Array
from fjr_core.simulation.deviations import DEVIATIONS
from fjr_design.batch import ClosedLoop, Draws
from fjr_design.batch.draws import PARAMETERS as DRAWN
from fjr_design.batch.draws import uniform

from .cells import SETTLED, cells_of
from .uncertain_robot import PARAMETERS

ROBOTS, SHARE, CONFIDENCE = 299, 0.99, 0.95
"""Robots, and the share of all robots of the distribution whose errors are smaller, with this confidence."""
SEED = 1


@dataclass(frozen=True)
class DrawnRobots:
    """Runs of ROBOTS robots over `seconds`. largest (n,) [rad]: |q_l - q_ld| of stable loops. unstable: the others."""

    largest: Array
    unstable: int
    seconds: float


def drawn_robots(
    scenario: Scenario, errors: Mapping[str, ArrayLike], delay: float, payload_position: ArrayLike
) -> DrawnRobots | None:
    """Return the largest errors of robots that start on the reference; None for errors that cannot be drawn.

    Those are torques, a changing delay, parameters that Draws has not, and payload_mass beside a factor of gravity.
    Every parameter is drawn uniformly within its error, each joint by itself. errors, delay [s], payload_position: as
    of `bound_errors`. The law runs without limits, late by the delay, for a period of the reference and SETTLED.
    """
    drawable = {"payload", *DRAWN} & {*PARAMETERS}
    if not errors.keys() <= drawable or {"payload_mass", "gravity"} <= errors.keys():
        return None
    robot, reference, T = scenario.robot, scenario.reference, scenario.sample_period
    values = {name: _drawn(name, size, robot.n, payload_position) for name, size in errors.items()}
    if "payload" in values:  # all masses and inertias
        factor = values.pop("payload")
        values |= {"link_inertia": factor, "gravity": factor * values.get("gravity", 1.0)}
    q, dq, *_ = jets = reference.jets(0.0)
    _, q_m, dq_m, *_ = (each.full().ravel() for each in inverse_dynamics(robot)(*jets))
    cells = cells_of(reference, T, verified=False)
    duration = cells.length * cells.count + SETTLED
    start, inner = robot.state(q, q_m, dq, dq_m), scenario.inner_steps
    loop = ClosedLoop(robot, scenario.law, reference, start, duration, T, inner, settle_after=0.0)
    outcomes = loop.run(Draws(ROBOTS, delay=delay, **{"payload_position": payload_position, **values}))
    largest = outcomes.peak[outcomes.stable].max(axis=0, initial=0.0)
    return DrawnRobots(largest, int(np.sum(~outcomes.stable)), duration)


def _drawn(name: str, error: ArrayLike, n: int, place: ArrayLike = 0.0) -> Array:
    """Return the values (ROBOTS, width) of a parameter within its error of its nominal value, or of the place.

    (ROBOTS,) for a parameter of one number, such as gravity, which has one factor for all joints.
    """
    width = 1 if name == "gravity" else DEVIATIONS[name].width(n)
    share = uniform(name, SEED, 0, ROBOTS, width)
    if name == "payload_mass":
        found = np.asarray(error) * share
    else:
        nominal = np.asarray(place) if name == "payload_position" else DEVIATIONS[name].nominal
        found = nominal + np.asarray(error) * (2 * share - 1)
    return found[:, 0] if width == 1 else found
