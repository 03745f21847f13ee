# SPDX-License-Identifier: Apache-2.0
"""Error of the velocity observer about equilibria, linearised by the derivative of its update in x_hat."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

import fjr_core as fjr
from fjr_core.law.linearized import equilibria_at
from fjr_core.numerics.checks import Array
from fjr_core.runtime.velocity_observer import LONGEST_CALL, corrections


def error_radii(robot: fjr.Robot, bandwidth: float, sample_period: float, configurations: ArrayLike) -> Array:
    """Return the spectral radii (k,) of the sampled error dynamics about equilibria at configurations (k, n) [rad].

    Below 1, a small estimation error decays by this factor per sample. The Jacobian of the observer in x_hat also
    governs the error, because plant and model steps agree; it includes the integrator.
    """
    function = fjr.VelocityObserver(robot, bandwidth).function
    arguments = function.mx_in()
    jacobian = ca.Function("error_slope", arguments, [ca.densify(ca.jacobian(function(*arguments), arguments[0]))])
    g, h = corrections(bandwidth, sample_period)
    calls = math.ceil(sample_period / LONGEST_CALL)
    dt, gain = sample_period / calls, [g, h / sample_period]
    points = equilibria_at(robot, np.asarray(configurations, dtype=float))
    radii = []
    for x, u in zip(points.x, points.u, strict=True):
        predicted, corrected = (jacobian(x, x[: 2 * robot.n], u, dt, by).full() for by in ([0.0, 0.0], gain))
        error = corrected @ np.linalg.matrix_power(predicted, calls - 1)
        radii.append(np.abs(np.linalg.eigvals(error)).max())
    return np.array(radii)
