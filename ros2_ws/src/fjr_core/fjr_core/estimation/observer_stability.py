# SPDX-License-Identifier: Apache-2.0
"""How fast the velocity observer's error decays: the sampled error dynamics linearised at equilibria."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import StateError
from ..numerics.checks import Array
from ..robot.configuration_sampling import checked_configurations
from ..robot.equilibrium import rest_points
from ..robot.robot import Robot
from .velocity_observer import CONFIGURATIONS, LONGEST_CALL, LONGEST_GAP, VelocityObserver, corrections


def error_radii(robot: Robot, bandwidth: float, sample_period: float, configurations: ArrayLike | None = None) -> Array:
    """Spectral radii (k,) of the sampled error dynamics about equilibria at configurations (k, n) [rad].

    Below 1 an estimate near the state converges to it, by that factor a sample; exact for what runs, its integrator
    included. configurations: 64 sampled ones when none are given. sample_period [s]: at most LONGEST_GAP.
    Raises StateError for shapes or numbers that do not fit, ParameterError for the bandwidth.
    """
    if not 0 < sample_period <= LONGEST_GAP:
        raise StateError(f"sample_period is {sample_period} s; expected more than 0 and at most {LONGEST_GAP}")
    points = rest_points(robot, checked_configurations(robot, configurations, CONFIGURATIONS))
    slope = _error_slope(VelocityObserver(robot, bandwidth).function)
    g, h = corrections(bandwidth, sample_period)
    calls = math.ceil(sample_period / LONGEST_CALL)
    dt, gain = sample_period / calls, [g, h / sample_period]
    radii = []
    for x, u in zip(points.x, points.u, strict=True):
        predicted, corrected = (slope(x, x[: 2 * robot.n], u, dt, by).full() for by in ([0.0, 0.0], gain))
        error = corrected @ np.linalg.matrix_power(predicted, calls - 1)
        radii.append(np.abs(np.linalg.eigvals(error)).max())
    return np.array(radii)


def _error_slope(function: ca.Function) -> ca.Function:
    """The Jacobian of the observer's function in x_hat: the error obeys it as well, the plant's step being the same."""
    arguments = function.mx_in()
    jacobian = ca.jacobian(function(*arguments), arguments[0])
    return ca.Function("error_slope", arguments, [ca.densify(jacobian)])
