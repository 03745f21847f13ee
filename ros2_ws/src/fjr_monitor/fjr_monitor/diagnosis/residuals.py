# SPDX-License-Identifier: Apache-2.0
"""Compute the residual torques of the link and motor equations on a record, with signals that may explain them.

    link    M_l ddq_l + C dq_l + D_l dq_l + grad P_l - K zeta = r_l
    motor   M_m ddq_m + D_m dq_m + K zeta - B_m u = r_m

Each is the error of the one-step-ahead prediction of a velocity times the inertia, divided by the step: the generalised
momentum residual of A. De Luca, R. Mattone, Actuator failure detection and isolation using generalized momenta, ICRA
2003. Means over blocks of intervals suppress the noise of velocity sensors, which telescopes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model import springs
from fjr_core.model.robot import Robot
from fjr_core.monitoring.certificate import Prediction
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.delay_estimation import Acting, acting, effort_delay
from fjr_monitor.diagnosis.record import Innovations, Record, consecutive, foreseen, held, needed

from .thresholds import BLOCK

FEWEST_BLOCKS = 20
"""Smallest number of blocks of a regression."""
FLOOR = 1e-3
"""Residual relative to the torques of its equation that is attributed to rounding and discretisation."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residual torques over b blocks of intervals, and the regressors.

    r (b, 2n) [N m]: of the link equations, then of the motor equations. sigma (2n,) [N m]: standard deviation of r due
    to noise and rounding. noise (2n,) [N m]: due to noise alone. q, dq, ddq (k, 2n): midpoint position, velocity and
    acceleration of each interval. u (k, n) [N m]: acting effort.
    """

    record: Record
    robot: Robot
    prediction: Prediction
    first: NDArray[np.intp]
    kept: NDArray[np.intp]
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
        return block_means(values[self.kept], self.block)

    def placed(self, signals: dict[int, Array]) -> Array:
        """Return the block means (b, 2n, 1) of signals (k,), each in the equation of its number, zero elsewhere."""
        columns = np.zeros((len(self.r), 2 * self.robot.n, 1))
        for channel, signal in signals.items():
            columns[:, channel, 0] = self.means(signal)
        return columns

    def of_offset(self, channel: int, offset: float = 1e-4) -> Array:
        """Return the residual (b, 2n) [N m/rad] due to an offset of one position sensor, per radian.

        The model predicts from q + offset, the robot moves from q.
        """
        record, first = self.record, self.first
        shift = np.zeros(2 * self.robot.n)
        shift[channel] = offset
        u, dt = held(record.u)[first], np.diff(record.t)[first]
        q, dq = record.position[first], record.velocity[first]
        ahead = [self.prediction.along(q - sign * shift, dq, u, dt)[1] for sign in (0.5, -0.5)]
        return self.means(torques(self.robot, q, (ahead[0] - ahead[1]) / offset, dt))


def residuals(record: Record, law: TrackingLaw, found: Innovations, acted: Acting) -> Residuals | None:
    """Return the residuals of a record; None if it has too few intervals.

    found: innovations of the record. acted: deviations of the acting effort, from the measured torque if available.
    """
    robot, first = law.robot, consecutive(record)
    if len(first) < FEWEST_BLOCKS:
        return None
    block = int(np.clip(len(first) // (2 * FEWEST_BLOCKS), 1, BLOCK))
    kept = np.flatnonzero(~(acted.cut != 0).any(axis=1))
    if len(kept) < FEWEST_BLOCKS * block:
        return None
    n, late = robot.n, _late(found, robot)
    raw = torques(robot, record.position[first], found.error[:, 2 * n :], found.dt)
    raw[:, n:] -= late @ robot.B_m.T
    second = first + 1
    q, dq = ((values[first] + values[second]) / 2 for values in (record.position, record.velocity))
    ddq = (record.velocity[second] - record.velocity[first]) / found.dt[:, None]
    u, r = found.sent + late, block_means(raw[kept], block)
    spring = np.abs(springs.torques(robot, q[:, n:] - q[:, :n]))
    scale = np.hstack([spring, spring + np.abs(u @ robot.B_m.T)])
    noise = deviation(r)
    sigma = np.hypot(noise, FLOOR * np.sqrt(np.mean(scale**2, axis=0)) + 1e-12)
    return Residuals(record, robot, Prediction(law), first, kept, block, r, sigma, noise, q, dq, ddq, u)


def torques(robot: Robot, q: Array, change: Array, dt: Array) -> Array:
    """Return the torques (k, 2n) [N m] that change the velocities by `change` (k, 2n) [rad/s] within dt (k,) [s]."""
    n, rate = robot.n, change / dt[:, None]
    M_l = over_rows(lambda q_l: robot.links.M_l(q_l).full(), q[:, :n], n)
    return np.hstack([np.einsum("kij,kj->ki", M_l, rate[:, :n]), rate[:, n:] @ robot.M_m.T])


def over_rows(function: Callable[[Array], Array], rows: Array, columns: int) -> Array:
    """Return the (k, m, columns) values of a CasADi function mapped over k arguments as columns."""
    values = function(rows.T)
    return values.reshape(len(values), len(rows), columns).transpose(1, 0, 2)


def block_means(values: Array, block: int) -> Array:
    """Return the means of `block` consecutive rows; a remainder is ignored."""
    count = len(values) // block
    means: Array = values[: count * block].reshape(count, block, *values.shape[1:]).mean(axis=1)
    return means


def _late(found: Innovations, robot: Robot) -> Array:
    """Return acting minus sent effort (k, n) [N m] from the motion alone, since the measured torque may be faulty."""
    unmeasured = replace(found, before=np.full_like(found.sent, np.nan), after=np.full_like(found.sent, np.nan))
    age = effort_delay(unmeasured, robot)
    usual = foreseen(found)
    if not age.late:
        return usual
    acted = acting(unmeasured, age, needed(unmeasured, robot))
    return usual + acted.late + acted.lost


def deviation(r: Array) -> Array:
    """Estimate the standard deviation (m,) of white noise on r (b, m) from the median of its second differences."""
    second = np.diff(r, 2, axis=0) ** 2 / 6
    return np.sqrt(np.median(second, axis=0) / 0.455)
