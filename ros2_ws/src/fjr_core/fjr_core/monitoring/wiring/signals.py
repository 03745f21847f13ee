# SPDX-License-Identifier: Apache-2.0
"""Compare signals of a window of samples that must follow each other.

    motor   y_m = M_m ddq_m + K zeta + D_m dq_m   must follow   B_m u
    link    y_l = M_l ddq_l + D_l dq_l            must follow   K zeta
    speed   dq                                    must follow   the slope of q

Each pair is compared without its mean (offsets, weight) and with a free factor from 0.5 to 2 (wrong inertia, stiffness
or torque constant). The effort may be delayed by up to OLDEST samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...numerics.checks import Array
from ...robot.robot import Robot
from .hypotheses import Window

Flags = NDArray[np.bool_]

FEWEST = 8
"""Smallest number of intervals of a comparison."""
OLDEST = 5
"""Largest delay of an effort in samples."""
FACTORS = (0.5, 2.0)
"""Range of the factor between the two sides of an equation due to wrong parameters."""
SPEED_FACTORS = (0.7, 1.4)
"""Range of the factor between a velocity and the slope of its position due to a wrong scale."""
ROUGH = 0.5
"""A signal is noise if its changes from interval to interval have more than this share of its sum of squares."""


@dataclass(frozen=True)
class Rows:
    """Unexplained share of signals (k,) and flags of smooth signals (k,); noise is not evidence."""

    unexplained: Array
    smooth: Flags

    @classmethod
    def of(cls, robot: Robot, window: Window) -> Rows:
        """Compare the two sides of the 2n equations, links then motors."""
        n = robot.n
        q = (window.q[1:] + window.q[:-1]) / 2
        spring, link, motor = (q[:, n:] - q[:, :n]) @ robot.K, link_torques(robot, window), motor_torques(robot, window)
        given = window.u[:-1] @ robot.B_m.T
        late = [_unexplained(motor, given, d) for d in range(OLDEST + 1) if len(motor) - d >= FEWEST]
        links, motors = _unexplained(link, spring, 0), np.min(late, axis=0)
        return cls(np.concatenate([links, motors]), np.concatenate([_smooth(link), _smooth(motor)]))


def link_torques(robot: Robot, window: Window) -> Array:
    """Return M_l ddq_l + D_l dq_l of the intervals (m - 1, n) [N m]."""
    n, dq = robot.n, window.dq[:, : robot.n]
    q = (window.q[1:, :n] + window.q[:-1, :n]) / 2
    ddq = np.diff(dq, axis=0) / np.diff(window.t)[:, None]
    return np.asarray(ddq @ robot.M_l(q[len(q) // 2]) + (dq[1:] + dq[:-1]) / 2 @ robot.D_l)


def motor_torques(robot: Robot, window: Window) -> Array:
    """Return M_m ddq_m + K zeta + D_m dq_m of the intervals (m - 1, n) [N m]."""
    n, dq = robot.n, window.dq[:, robot.n :]
    q = (window.q[1:] + window.q[:-1]) / 2
    ddq = np.diff(dq, axis=0) / np.diff(window.t)[:, None]
    return np.asarray(ddq @ robot.M_m + (q[:, n:] - q[:, :n]) @ robot.K + (dq[1:] + dq[:-1]) / 2 @ robot.D_m)


def motor_squares(robot: Robot, window: Window) -> Array:
    """Return the sums of squares (n,) [N^2 m^2] of motor torque minus effort, including the means."""
    return np.asarray(((motor_torques(robot, window) - window.u[:-1] @ robot.B_m.T) ** 2).sum(axis=0))


def speeds(window: Window) -> Rows:
    """Compare each velocity (2n,) with the slope of its position."""
    slope, mean = slopes(window)
    return Rows(unfollowed(mean, slope, SPEED_FACTORS), _smooth(mean))


def differs(window: Window) -> Flags:
    """Return which velocities (2n,) differ from the slope of their position by more than the noise of the slope."""
    slope, mean = slopes(window)
    noise = (np.diff(slope, axis=0) ** 2).sum(axis=0)
    return np.asarray(noise < ROUGH * ((mean - slope) ** 2).sum(axis=0))


def slopes(window: Window) -> tuple[Array, Array]:
    """Return slopes of the positions and mean velocities of the intervals (m - 1, 2n) [rad/s]."""
    slope = np.diff(window.q, axis=0) / np.diff(window.t)[:, None]
    return slope, (window.dq[1:] + window.dq[:-1]) / 2


def _unexplained(y: Array, x: Array, d: int) -> Array:
    """Return the share of y that x delayed by d samples does not explain, both without their means."""
    y, x = y[d:], x[: len(x) - d]
    return unfollowed(y - y.mean(axis=0), x - x.mean(axis=0), FACTORS)


def unfollowed(y: Array, x: Array, factors: tuple[float, float]) -> Array:
    """Return the share of y (m, k) that x (m, k) times a factor within `factors` does not explain; 1 if y is 0."""
    power = (y * y).sum(axis=0)
    factor = np.clip(np.nan_to_num((x * y).sum(axis=0) / (x * x).sum(axis=0)), *factors)
    left = ((y - factor * x) ** 2).sum(axis=0)
    return np.where(power > 0, left / np.maximum(power, 1e-300), 1.0)


def _smooth(y: Array) -> Flags:
    """Return which signals (m, k) change little from interval to interval."""
    centred = y - y.mean(axis=0)
    power, change = (centred**2).sum(axis=0), (np.diff(y, axis=0) ** 2).sum(axis=0)
    return np.asarray((change < ROUGH * power) & (power > 1e-12 * (1 + (y * y).sum(axis=0))))
