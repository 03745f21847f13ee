# SPDX-License-Identifier: Apache-2.0
"""Decide whether the motion can be simulated: torques that the model lacks add up twice over the time of a segment.

    d = integral integral r_m / (B + M_jj) less the line of a free initial state,   r_m: error of the motor's equation

A simulation predicts the deflection of a spring only if d is smaller. Friction of large gears and a counterbalance
easily move a simulated motor by a hundred times the deflection.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import detrend

from fjr_core.numerics.checks import Array

from .coordinates import packed
from .equation_error import motor_side, rigid_along
from .estimation_problem import Estimation, poses
from .initial_guess import FilteredMotion, both_sides, shifted

MOST = 1.0
"""Displacement, relative to the deflection, beyond which a simulation does not predict it."""


def is_simulated(setup: Estimation, motions: Sequence[FilteredMotion], z: Array) -> bool:
    """Return whether the simulated motion predicts the deflection of some joint, at parameters z (p,)."""
    relative = displacement(setup, motions, z)
    return not len(relative) or bool(np.min(relative) <= MOST)


def displacement(setup: Estimation, motions: Sequence[FilteredMotion], z: Array) -> Array:
    """Return by how much torques that the model lacks displace the joints in a segment, relative to their deflection.

    (n,), root mean squares over all records at z (p,). Without the joints that are not measured on both sides.
    """
    n, length = setup.robot.n, setup.segment_length(setup.coordinates.parameters(z))
    moved, deflected = np.zeros(n), np.zeros(n)
    inertia, p = _inertia(setup, z), setup.coordinates.parameters(z)
    for record, motion in zip(setup.records, motions, strict=True):
        rigid = rigid_along(setup, motion, z)
        for j in (j for j in range(n) if both_sides(record, j)):
            side = motor_side(setup, motion, rigid, z, j)
            d = _displaced(np.where(side.used, side.errors, 0.0) / inertia[j], motion.dt, length)
            deflection = motion.q_m[:, j] - shifted(motion.q_l[:, j], motion.dt, p["link_skew"][j])
            moved[j] += np.sum(d**2)
            deflected[j] += np.sum((deflection - np.mean(deflection)) ** 2)
    return np.sqrt(moved[deflected > 0] / deflected[deflected > 0])


def _displaced(acceleration: Array, dt: float, length: float) -> Array:
    """Return the second integral (k,) of an acceleration in segments of a length [s], without the line of each."""
    pieces = np.array_split(acceleration, max(1, round(len(acceleration) * dt / length)))
    return np.concatenate([detrend(_integral(_integral(each, dt), dt)) for each in pieces])


def _integral(signal: Array, dt: float) -> Array:
    return np.asarray(cumulative_trapezoid(signal, dx=dt, initial=0.0))


def _inertia(setup: Estimation, z: Array) -> Array:
    """Return the mean inertia (n,) of motor and links together."""
    p, arm = setup.coordinates.parameters(z), setup.arm(setup.coordinates)
    where = np.vstack([poses(record) for record in setup.records])
    links = np.mean([np.diag(arm.link_inertia(q, packed(arm, p)).full()) for q in where], axis=0)
    return np.asarray(links + p["motor_inertia"])
