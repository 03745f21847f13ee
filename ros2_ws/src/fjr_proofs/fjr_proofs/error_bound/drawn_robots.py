# SPDX-License-Identifier: Apache-2.0
"""Simulate robots within stated errors, drawn and at the worst corner found: the error where no bound is proven.

Of k independent values the largest exceeds their quantile of order p with probability 1 - p^k: 95 % for p = 0.99 and
k = 299. S. S. Wilks, "Determination of sample sizes for setting tolerance limits", Ann. Math. Statist. 12, 1941.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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


Peaks = Callable[[Array], Array]
"""Return the largest errors |q_l - q_ld| (k, n) [rad] of robots with shares (k, d) of their errors, 0 to 1."""


@dataclass(frozen=True)
class DrawnRobots:
    """Runs over `seconds` of ROBOTS robots, of which `unstable` have an unstable loop.

    largest (n,) [rad]: |q_l - q_ld| of the others. corner (n,) [rad]: of `worst_corner`, infinite for an unstable loop.
    """

    largest: Array
    corner: Array
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
    q, dq, *_ = jets = reference.jets(0.0)
    _, q_m, dq_m, *_ = (each.full().ravel() for each in inverse_dynamics(robot)(*jets))
    cells = cells_of(reference, T, verified=False)
    duration = cells.length * cells.count + SETTLED
    start, inner = robot.state(q, q_m, dq, dq_m), scenario.inner_steps
    loop = ClosedLoop(robot, scenario.law, reference, start, duration, T, inner, settle_after=0.0)
    widths = {name: 1 if name == "gravity" else DEVIATIONS[name].width(robot.n) for name in errors}  # or of each joint

    def peaks(shares: Array) -> Array:
        parts = np.split(shares, np.cumsum(list(widths.values()))[:-1], axis=1)
        values = {
            name: _value(name, errors[name], part, payload_position) for name, part in zip(errors, parts, strict=True)
        }
        if "payload" in values:  # all masses and inertias
            factor = values.pop("payload")
            values |= {"link_inertia": factor, "gravity": factor * values.get("gravity", 1.0)}
        outcomes = loop.run(Draws(len(shares), delay=delay, **{"payload_position": payload_position, **values}))
        return np.where(outcomes.stable[:, None], outcomes.peak, np.inf)

    shares = np.hstack([uniform(name, SEED, 0, ROBOTS, width) for name, width in widths.items()])
    drawn = peaks(shares)
    unstable = np.isinf(drawn).any(axis=1)
    worst, joint = np.unravel_index(np.argmax(drawn), drawn.shape)
    corner = worst_corner(peaks, np.round(shares[worst]), int(joint))
    return DrawnRobots(drawn[~unstable].max(axis=0, initial=0.0), corner, int(unstable.sum()), duration)


def worst_corner(peaks: Peaks, at: Array, joint: int) -> Array:
    """Return the errors (n,) of the corner of the class, shares of 0 and 1, to which changes from one (d,) lead.

    In each round all changes of a share that enlarge the error of the joint are made, or the best of them alone.
    """
    found = peaks(at[None])[0]
    while True:
        changed = np.abs(at - np.eye(len(at)))
        errors = peaks(changed)[:, joint]
        larger = errors > found[joint]
        if not larger.any():
            return np.asarray(found)
        options = np.array([changed[np.argmax(errors)], np.abs(at - larger)])
        ends = peaks(options)
        best = int(np.argmax(ends[:, joint]))
        at, found = options[best], ends[best]


def _value(name: str, error: ArrayLike, share: Array, place: ArrayLike) -> Array:
    """Return the values (k, width) of a parameter at shares of its error about its nominal value, or the place.

    (k,) for a parameter of one number, such as gravity, which has one factor for all joints.
    """
    if name == "payload_mass":
        found = np.asarray(error) * share
    else:
        nominal = np.asarray(place) if name == "payload_position" else DEVIATIONS[name].nominal
        found = nominal + np.asarray(error) * (2 * share - 1)
    return found[:, 0] if share.shape[1] == 1 else found
