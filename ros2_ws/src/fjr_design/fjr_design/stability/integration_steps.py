# SPDX-License-Identifier: Apache-2.0
"""Integrator steps per sample that the fastest mode of a plant needs."""

from __future__ import annotations

import numpy as np

from fjr_core.law.linearized import equilibria_at, plant_matrices
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array

RK4_REACH = 2.7  # rad: largest stable product of step and frequency for the Runge-Kutta method of order 4


def fastest_mode(robot: Robot, configurations: Array) -> float:
    """Return the largest |eigenvalue| [rad/s] of the plant, linearised at link positions (k, n) [rad]."""
    A, _ = plant_matrices(equilibria_at(robot, configurations))
    return float(np.abs(np.linalg.eigvals(A)).max())


def least_steps(frequency: float, sample_period: float) -> int:
    """Return the fewest steps per sample [s] with which rk4 is stable for a mode of this frequency [rad/s]."""
    return max(1, int(np.ceil(frequency * sample_period / RK4_REACH)))
