# SPDX-License-Identifier: Apache-2.0
"""Residual torques of the link and motor equations on a record, and how they change with what encoders measure.

    link    M_l ddq_l + C dq_l + D_l dq_l + grad P_l - K zeta = r_l
    motor   M_m ddq_m + D_m dq_m + K zeta - B_m u = r_m

Each residual is the error of the one-step-ahead prediction of a velocity times the inertia, divided by the step: the
generalised momentum residual of A. De Luca, R. Mattone, Actuator failure detection and isolation using generalized
momenta, ICRA 2003. Means over blocks of intervals suppress the noise of velocity sensors, which telescopes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model import springs
from fjr_core.model.robot import Robot
from fjr_core.monitoring.certificate import Prediction
from fjr_core.numerics.checks import Array

from .delay_estimation import unsure
from .record import Innovations, blocks_of
from .thresholds import BLOCK

FEWEST_BLOCKS = 20  # smallest number of blocks of a regression
FLOOR = 3e-4
"""Residual relative to the torques of its equation that is attributed to rounding and discretisation."""
STEP = 1e-4  # of differences of the prediction [rad, rad/s]


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residual torques over b blocks of intervals, and the regressors.

    r (b, 2n) [N m]: of the link equations, then of the motor equations. sigma (b, 2n) [N m]: standard deviation of r
    due to noise, rounding and unknown instants of efforts. noise (2n,) [N m]: due to noise alone. q, dq, ddq (k, 2n):
    midpoint position, velocity and acceleration of each interval. u (k, n) [N m]: acting effort.
    """

    found: Innovations
    robot: Robot
    prediction: Prediction
    block: int
    r: Array
    sigma: Array
    noise: Array
    q: Array
    dq: Array
    ddq: Array
    u: Array

    def means(self, values: Array) -> Array:
        """Return the block means (b, ...) of values (k, ...) of the intervals."""
        return np.asarray(blocks_of(values, self.block).mean(axis=1))

    def placed(self, signals: dict[int, Array]) -> Array:
        """Return the block means (b, 2n, 1) of signals (k,), each in the equation of its number, zero elsewhere."""
        columns = np.zeros((len(self.r), 2 * self.robot.n, 1))
        for channel, signal in signals.items():
            columns[:, channel, 0] = self.means(signal)
        return columns

    def of_encoder(self, channel: int) -> Callable[[Array, Array], Array]:
        """Return the residual (b, 2n, 1) as a function of errors (k, 2) of an encoder's position and velocity.

        The errors are those at both states. The model predicts from what is measured, the robot moves from what is not.
        """
        robot, (q, dq) = self.robot, np.split(self.found.states[:, 0], 2, axis=1)
        dt, sent, unit = self.found.dt, self.found.sent, np.eye(2 * self.robot.n)[channel]

        def differs(of_q: Array, of_dq: Array) -> Array:
            ahead = [self.prediction.along(q + h * of_q, dq + h * of_dq, sent, dt)[1] for h in (-STEP / 2, STEP / 2)]
            return torques(robot, q, (ahead[0] - ahead[1]) / STEP, dt)

        of_q, of_dq = differs(unit, 0 * unit), differs(0 * unit, unit)
        of_last = torques(robot, q, np.tile(unit, (len(q), 1)), dt)

        def column(position: Array, velocity: Array) -> Array:
            first = of_q * position[:, :1] + of_dq * velocity[:, :1]
            return self.means(first + of_last * velocity[:, 1:])[:, :, None]

        return column


def residuals(found: Innovations, late: Array, law: TrackingLaw) -> Residuals | None:
    """Return the residuals of intervals in which no motor was saturated; None if they are too few.

    late (k, n) [N m]: acting minus sent effort.
    """
    block = int(np.clip(len(found) // (2 * FEWEST_BLOCKS), 1, BLOCK))
    if len(found) < FEWEST_BLOCKS * block:
        return None
    robot, n = law.robot, law.robot.n
    first, second = found.states.transpose(1, 0, 2)
    (q, dq), ddq = np.split((first + second) / 2, 2, axis=1), (second - first)[:, 2 * n :] / found.dt[:, None]
    raw = torques(robot, first[:, : 2 * n], found.error[:, 2 * n :], found.dt)
    raw[:, n:] -= late @ robot.B_m.T
    u, r = found.sent + late, blocks_of(raw, block).mean(axis=1)
    spring = np.abs(springs.torques(robot, q[:, n:] - q[:, :n]))
    scale = np.sqrt(blocks_of(np.hstack([spring, spring + np.abs(u @ robot.B_m.T)]) ** 2, block).mean(axis=1))
    scale = np.maximum(scale, np.median(scale, axis=0))  # where a motion rests for a moment its torques vanish
    noise = sensor_noise(found, raw, robot, block)
    sigma = np.hypot(noise, FLOOR * scale + 1e-12)
    unknown = (found.older - found.sent) @ robot.B_m.T * unsure(found, float(np.median(found.dt)))[:, None]
    changes = blocks_of(unknown, block)  # efforts begin late all over a block, or by chance in each interval
    sigma[:, n:] = np.sqrt(sigma[:, n:] ** 2 + changes.mean(axis=1) ** 2 + (changes**2).mean(axis=1) / block)
    return Residuals(found, robot, Prediction(law), block, r, sigma, noise, q, dq, ddq, u)


def sensor_noise(found: Innovations, raw: Array, robot: Robot, block: int) -> Array:
    """Estimate the standard deviation (2n,) [N m] that noise of the sensors gives the block means of residual torques.

    raw (k, 2n) [N m]: residual torques of the intervals. Noise of a velocity telescopes in a block; an encoder adds the
    stiffness times its error, of variance s^2. The trapezoidal rule reveals s^2 from positions and velocities alone: an
    unmodelled torque is no noise, however fast it changes. An encoder that moves by a step in a share p of the
    intervals keeps an error for 1/p of them, and its steps reveal 4 p of s^2.
    """
    n, q = robot.n, found.states[:, :, : 2 * robot.n]
    trapezoidal = found.error[:, : 2 * n] - found.dt[:, None] / 2 * found.error[:, 2 * n :]
    s2 = np.mean(np.diff(trapezoidal, axis=0) ** 2, axis=0) / 6
    p = np.maximum(np.mean(q[:, 0] != q[:, 1], axis=0), 1 / len(found))
    of_mean = s2 * np.maximum(1 / (4 * p), 1) / np.clip(block * p, 1, block)
    tangent = np.mean(springs.hardening(robot, q[:, 0, n:] - q[:, 0, :n]) ** 2, axis=0)[:, None] * robot.K**2
    of_step, of_mean = (np.tile(tangent @ (each[:n] + each[n:]), 2) for each in (s2, of_mean))
    of_velocity = np.maximum(6 * deviation(raw) ** 2 - 6 * of_step, 0.0) / 20  # third differences: 1 -3 3 -1
    return np.asarray(np.sqrt(2 * of_velocity / block**2 + of_mean))


def torques(robot: Robot, q: Array, change: Array, dt: Array) -> Array:
    """Return the torques (k, 2n) [N m] that change the velocities by `change` (k, 2n) [rad/s] within dt (k,) [s]."""
    n, rate = robot.n, change / dt[:, None]
    M_l = over_rows(lambda q_l: robot.links.M_l(q_l).full(), q[:, :n], n)
    return np.hstack([np.einsum("kij,kj->ki", M_l, rate[:, :n]), rate[:, n:] @ robot.M_m.T])


def over_rows(function: Callable[[Array], Array], rows: Array, columns: int) -> Array:
    """Return the (k, m, columns) values of a CasADi function mapped over k arguments as columns."""
    values = function(rows.T)
    return values.reshape(len(values), len(rows), columns).transpose(1, 0, 2)


def explained_share(left: float, total: float) -> float:
    """Return the share of a sum of squares that a fit explains; left: what it leaves. Both less what noise makes."""
    return float(np.clip(1 - max(left, 0.0) / max(total, 1e-300), 0.0, 1.0))


def deviation(r: Array) -> Array:
    """Estimate the standard deviation (m,) of white noise on r (b, m) from the median of its second differences."""
    return np.sqrt(np.median(np.diff(r, 2, axis=0) ** 2 / 6, axis=0) / 0.455)
