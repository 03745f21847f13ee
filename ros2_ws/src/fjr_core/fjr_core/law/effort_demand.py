# SPDX-License-Identifier: Apache-2.0
"""Compute the largest efforts that a motion asks for: the inverse dynamics of the flexible-joint robot along it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model.robot import Robot
from ..motions.sampled_motion import SampledMotion
from ..numerics.checks import Array
from .inverse_dynamics import inverse_dynamics

SUBDIVISIONS = 4, 4096
"""Instants per piece of the motion, and instants in all, at least."""
EVENLY, LARGEST = 1024, 64
"""Instants at which efforts are evaluated: spread evenly, and those of the largest derivatives of each joint."""


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
    jets = motion.jets(instants)
    chosen = _chosen(jets)
    jets, instants = jets[chosen], instants[chosen]
    motor_torque = inverse_dynamics(robot).map(len(instants))(*(row.T for row in jets.swapaxes(0, 1)))[-1].full()
    effort = np.abs(np.linalg.solve(robot.B_m, motor_torque))
    effort[np.isnan(effort)] = np.inf
    largest = effort.argmax(axis=1)
    return EffortDemand(effort[np.arange(robot.n), largest], instants[largest])


def _chosen(jets: Array) -> NDArray[np.intp]:
    """Return the indices of the instants at which to evaluate the efforts of jets (k, 5, n).

    Efforts vary slowly with position, velocity and acceleration, and peak with the derivatives that peak.
    """
    k = len(jets)
    derivatives = np.abs(jets[:, 2:]).reshape(k, -1)
    peaks = np.argpartition(derivatives, -min(LARGEST, k), axis=0)[-min(LARGEST, k) :]
    return np.unique(np.concatenate([np.linspace(0, k - 1, min(EVENLY, k)).astype(int), peaks.ravel()]))
