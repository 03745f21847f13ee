# SPDX-License-Identifier: Apache-2.0
"""Compute the largest efforts that a motion asks for: the inverse dynamics of the flexible-joint robot along it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..numerics.checks import Array
from ..robot.robot import Robot
from ..trajectories.sampled_motion import SampledMotion
from .inverse_dynamics import inverse_dynamics

SUBDIVISIONS = 4, 4096
"""Instants per piece of the reference, and instants in all, at least; short pieces are where efforts peak."""
BLOCK = 4096


class EffortDemand(NamedTuple):
    """Largest |u| (n,) [N m] along a motion, and the times (n,) [s] at which it is needed."""

    peak: Array
    at: Array


def effort_demand(robot: Robot, motion: SampledMotion, t0: float = 0.0, t1: float = np.inf) -> EffortDemand:
    """Return the largest efforts along a motion from t0 to t1 [s].

    u = B_m^-1 (M_m ddtheta + D_m dtheta + tau), by the inverse dynamics of the flexible-joint robot.
    """
    knots = motion.pieces.times
    times = knots[np.searchsorted(knots, t0, side="right") - 1 : np.searchsorted(knots, t1) + 1]
    parts = max(SUBDIVISIONS[0], -(-SUBDIVISIONS[1] // len(times)))
    inner = times[:-1, None] + np.diff(times)[:, None] * np.arange(parts) / parts
    instants = np.append(inner.ravel(), np.nextafter(times[-1], -np.inf))
    torque = inverse_dynamics(robot)
    blocks = []
    for block in np.array_split(instants, -(-len(instants) // BLOCK)):
        jets = motion.jets(block)
        rows = torque.map(len(block))(*(jets[:, order].T for order in range(jets.shape[1])))[-1].full()
        blocks.append(np.abs(np.linalg.solve(robot.B_m, rows)))
    effort = np.concatenate(blocks, axis=1)
    effort[np.isnan(effort)] = np.inf
    largest = effort.argmax(axis=1)
    return EffortDemand(effort[np.arange(robot.n), largest], instants[largest])
