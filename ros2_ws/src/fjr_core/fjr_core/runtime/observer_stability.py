# SPDX-License-Identifier: Apache-2.0
"""Convergence of the velocity observer: its sampled error dynamics linearised about equilibria."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import StateError
from ..law.linearized import equilibria_at
from ..model.configuration_sampling import checked_configurations
from ..model.robot import Robot
from ..numerics.checks import Array
from .velocity_observer import CONFIGURATIONS, LONGEST_CALL, LONGEST_GAP, VelocityObserver, corrections


def error_radii(robot: Robot, bandwidth: float, sample_period: float, configurations: ArrayLike | None = None) -> Array:
    """Return the spectral radii (k,) of the sampled error dynamics about equilibria at configurations (k, n) [rad].

    Below 1, a small estimation error decays by this factor per sample. The result includes the integrator of the
    observer. configurations: 64 sampled ones by default. sample_period [s]: at most LONGEST_GAP.
    Raises StateError for wrong shapes or numbers, ParameterError for the bandwidth.
    """
    if not 0 < sample_period <= LONGEST_GAP:
        raise StateError(f"sample_period is {sample_period} s; expected more than 0 and at most {LONGEST_GAP}")
    points = equilibria_at(robot, checked_configurations(robot, configurations, CONFIGURATIONS))
    jacobian_function = _error_jacobian(VelocityObserver(robot, bandwidth).function)
    g, h = corrections(bandwidth, sample_period)
    calls = math.ceil(sample_period / LONGEST_CALL)
    dt, gain = sample_period / calls, [g, h / sample_period]
    radii = []
    for x, u in zip(points.x, points.u, strict=True):
        predicted, corrected = (jacobian_function(x, x[: 2 * robot.n], u, dt, by).full() for by in ([0.0, 0.0], gain))
        error = corrected @ np.linalg.matrix_power(predicted, calls - 1)
        radii.append(np.abs(np.linalg.eigvals(error)).max())
    return np.array(radii)


def _error_jacobian(function: ca.Function) -> ca.Function:
    """Return the Jacobian of the observer in x_hat; it also governs the error, because plant and model steps agree."""
    arguments = function.mx_in()
    jacobian = ca.jacobian(function(*arguments), arguments[0])
    return ca.Function("error_slope", arguments, [ca.densify(jacobian)])
