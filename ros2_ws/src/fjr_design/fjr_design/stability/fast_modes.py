# SPDX-License-Identifier: Apache-2.0
"""Modes that are too fast: for the plant's integrator, and springs whose oscillation the sampled loop answers too late.

A wrist that carries no tool oscillates fast on its spring:

    omega_i = sqrt(K_ii / m_i)      m_i: least inertia that joint i carries while the others move freely
    omega_i (T / 2 + delay) < pi/2  hold and delay lag by less than 90 degrees

Velocity feedback damps an oscillation up to this lag and drives it beyond. Without delay the bound is the Nyquist
frequency pi / T. Far beyond, a late loop can be stable in a narrow band, whose alias has the right phase.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fjr_core.law.linearized import Equilibria, equilibria_at, plant_matrices
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.urdf.typical_joints import least_free_inertia

RK4_REACH = 2.7  # rad: largest stable product of step and frequency for the Runge-Kutta method of order 4


def fastest_mode(robot: Robot, configurations: Array) -> float:
    """Return the largest |eigenvalue| [rad/s] of the plant, linearised at link positions (k, n) [rad]."""
    A, _ = plant_matrices(equilibria_at(robot, configurations))
    return float(np.abs(np.linalg.eigvals(A)).max())


def least_steps(frequency: float, sample_period: float) -> int:
    """Return the fewest steps per sample [s] with which rk4 is stable for a mode of this frequency [rad/s]."""
    return max(1, int(np.ceil(frequency * sample_period / RK4_REACH)))


def lag_limit(sample_period: float, delay: float) -> float:
    """Return the frequency [rad/s] at which the hold of sample_period [s] and a delay [s] lag by 90 degrees."""
    return float(np.pi / (sample_period + 2 * delay))


def late_spring(points: Equilibria, sample_period: float, delay: float = 0.0, joints: Sequence[str] = ()) -> str:
    """Return a sentence about the fastest spring if it is beyond `lag_limit`, else an empty text.

    A spring with a curve has its stiffest tangent at the equilibria. joints: names; without them the sentence has the
    number of the joint from 1.
    """
    robot, inertia, limit = points.robot, least_free_inertia(points.M_l), lag_limit(sample_period, delay)
    frequency = np.sqrt(np.diag(robot.K) * points.hardening.max(axis=0) / inertia)
    i = int(np.argmax(frequency))
    if frequency[i] < limit:
        return ""
    unit = "kg" if robot.units[i].position == "m" else "kg m^2"
    late = f" and a delay of {delay:g} s lag" if delay else " lags"
    return (
        f"the spring of joint {repr(joints[i]) if joints else i + 1} with the inertia that it carries "
        f"({inertia[i]:.3g} {unit}) oscillates at {frequency[i]:.4g} rad/s, and beyond {limit:.4g} rad/s the hold at "
        f"{1 / sample_period:g} Hz{late} by more than 90 degrees; expected more inertia (that of the tool in "
        "the URDF), a softer spring, the joint locked, or a faster loop"
    )
