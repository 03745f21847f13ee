# SPDX-License-Identifier: Apache-2.0
"""Signals of a window of samples that must agree, and their disagreement in units of noise and tolerance.

    link    y = M_l ddq_l + C dq_l + D_l dq_l + grad P_l   must equal   x = K zeta
    motor   y = M_m ddq_m + K zeta + D_m dq_m              must equal   x = B_m u
    speed   y = dq                                         must equal   x = slope of q

The difference y - x of a row is Gaussian with mean 0 and covariance S. S adds the noise of the sensors, estimated from
the window, and the effect of wrong parameters with the standard deviations below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...numerics.checks import Array
from ...robot.robot import Robot
from .hypotheses import Window

Flags = NDArray[np.bool_]

TOLERANCE = 0.15
"""Relative error of inertia, stiffness, weight and torque constant."""
SCALE = 0.08
"""Relative error of a velocity."""
LAGS, LAG = 5, 0.5
"""Longest delay of an effort or a velocity in samples, and weight of each earlier effort."""
LATE = 1.0
"""Delay of a velocity in samples."""
WEIGHT, OFFSET = 0.1, 1e-3
"""Constant torque relative to the largest weight, and offset of an encoder [rad]."""
ROUNDING = 0.01
"""Error of the means over an interval, relative to both sides."""
DOUBT = 1.5
"""Factor on the estimated variance of noise, which is uncertain after few samples."""


@dataclass(frozen=True)
class Rows:
    """Both sides y, x (4n, m - 1) of the rows: links, motors, velocities of links, velocities of motors.

    root (4n, m - 1, m - 1): inverse Cholesky factors of the covariances S.
    """

    y: Array
    x: Array
    root: Array

    @classmethod
    def of(cls, robot: Robot, window: Window, constant: Array) -> Rows:
        """Return the rows of a window; constant (n,) [N m]: standard deviation of constant torques."""
        means = _Means.of(window)
        parts = (
            _links(robot, window, means, constant),
            _motors(robot, window, means, constant),
            _speeds(window, means),
        )
        y, x = (np.concatenate([side.T for side in sides]) for sides in zip(*(part[:2] for part in parts), strict=True))
        S = np.concatenate([loose.transpose(2, 1, 0) @ loose.transpose(2, 0, 1) for _, _, loose, _, _ in parts])
        mean, change = (np.concatenate(noise) for noise in zip(*(part[3:] for part in parts), strict=True))
        rounding = ROUNDING**2 * ((y**2).mean(axis=1) + (x**2).mean(axis=1)) + 1e-18
        for variance, of in zip((mean, change, rounding), _correlations(y.shape[1]), strict=True):
            S += variance[:, None, None] * of
        return cls(y, x, np.linalg.inv(np.linalg.cholesky(S)))

    def misfit(self, sign: float = 1.0) -> Array:
        """Return (y - x)' S^-1 (y - x) of the rows (4n,), with x multiplied by `sign`."""
        return distances(self.root, self.y - sign * self.x)

    @property
    def squares(self) -> Array:
        """Return the mean squares (4n,) of y - x."""
        return np.asarray(((self.y - self.x) ** 2).mean(axis=1))

    @property
    def deviance(self) -> float:
        """Return minus twice the log-likelihood of all rows, without its constant: misfit plus log det S."""
        return float(self.misfit().sum() - 2 * np.log(np.diagonal(self.root, axis1=1, axis2=2)).sum())


def distances(root: Array, difference: Array) -> Array:
    """Return the squared norms (k,) of differences (k, m) in units of S, with inverse Cholesky factors (k, m, m)."""
    return np.asarray(((root @ difference[..., None])[..., 0] ** 2).sum(axis=1))


def torque_tolerance(robot: Robot, q: Array) -> Array:
    """Return the standard deviation (n,) [N m] of constant torques: friction, payload, offsets of encoders.

    The largest weight is that at the links' positions in q (2n,) or with one of them turned by pi / 2.
    """
    turned = q[: robot.n] + np.pi / 2 * np.eye(robot.n + 1, robot.n)
    return np.asarray(WEIGHT * np.abs([robot.grad_P_l(each) for each in turned]).max() + OFFSET * np.diag(robot.K))


@dataclass(frozen=True)
class _Means:
    """Means q, dq and slopes slope, ddq of positions and velocities over the intervals (m - 1, 2n).

    position, velocity (2n,): variances of the noise of the sensors. rate: 1 / h^2 of the mean interval h [1/s^2].
    """

    q: Array
    dq: Array
    slope: Array
    ddq: Array
    position: Array
    velocity: Array
    rate: float

    @classmethod
    def of(cls, window: Window) -> _Means:
        h, q, dq = np.diff(window.t)[:, None], window.q, window.dq
        slope, ddq = np.diff(q, axis=0) / h, np.diff(dq, axis=0) / h
        rate = float(1 / h.mean() ** 2)
        return cls((q[1:] + q[:-1]) / 2, (dq[1:] + dq[:-1]) / 2, slope, ddq, _noise(q), _noise(dq), rate)


_Part = tuple[Array, Array, Array, Array, Array]
"""y, x (m - 1, k), effects of wrong parameters (p, m - 1, k), variances (k,) of noise of means and of differences."""


def _links(robot: Robot, window: Window, means: _Means, constant: Array) -> _Part:
    n, middle = robot.n, len(means.q) // 2
    q_l, dq_l, ddq_l = means.q[middle, :n], means.dq[middle, :n], means.ddq[:, :n]
    M_l, spring, weight = robot.M_l(q_l), _spring(robot, means), _weights(robot, window.q[:, :n])
    y = ddq_l @ M_l + means.dq[:, :n] @ robot.D_l + robot.coriolis(q_l, dq_l, dq_l) + weight
    size = np.sqrt(np.diag(M_l))
    coupled = size * (ddq_l * size).T[..., None]  # torques of the motion of each joint, as large as full coupling
    loose = np.stack([np.broadcast_to(constant, y.shape), *TOLERANCE * np.stack([spring, weight, *coupled])])
    return y, spring, loose, _spring_noise(robot, means), means.rate * M_l**2 @ means.velocity[:n]


def _motors(robot: Robot, window: Window, means: _Means, constant: Array) -> _Part:
    n, spring, effort = robot.n, _spring(robot, means), _effort(robot, window)
    motion = means.ddq[:, n:] @ robot.M_m
    y = motion + spring + means.dq[:, n:] @ robot.D_m
    wrong = TOLERANCE * np.stack([spring, motion, effort[0]])
    loose = np.concatenate([np.broadcast_to(constant, y.shape)[None], wrong, LAG * (effort[1:] - effort[0])])
    return y, effort[0], loose, _spring_noise(robot, means), means.rate * robot.M_m**2 @ means.velocity[n:]


def _speeds(window: Window, means: _Means) -> _Part:
    loose = np.stack([SCALE * means.slope, LATE * np.diff(window.dq, axis=0)])
    return means.dq, means.slope, loose, means.velocity, means.rate * means.position


def _spring(robot: Robot, means: _Means) -> Array:
    """Return K zeta of the intervals (m - 1, n) [N m]."""
    return np.asarray((means.q[:, robot.n :] - means.q[:, : robot.n]) @ robot.K)


def _spring_noise(robot: Robot, means: _Means) -> Array:
    """Return the variance (n,) of the noise of K zeta [N^2 m^2]."""
    return np.asarray(robot.K**2 @ (means.position[: robot.n] + means.position[robot.n :]))


def _weights(robot: Robot, q_l: Array) -> Array:
    """Return grad P_l of the intervals (m - 1, n) [N m], interpolated between the ends of the window."""
    first, last = robot.grad_P_l(q_l[0]), robot.grad_P_l(q_l[-1])
    return np.asarray(first + np.linspace(0.0, 1.0, len(q_l) - 1)[:, None] * (last - first))


def _effort(robot: Robot, window: Window) -> Array:
    """Return B_m u (LAGS + 1, m - 1, n) [N m], delayed by 0 to LAGS samples; zero before the window."""
    return delayed(window.u[:-1] @ robot.B_m.T, np.zeros(robot.n))


def delayed(values: Array, before: Array | float) -> Array:
    """Return values (m, ...) delayed by 0 to LAGS samples (LAGS + 1, m, ...); before: value before the first one."""
    given = np.concatenate([np.broadcast_to(before, (LAGS, *values.shape[1:])), values])
    return np.stack([given[LAGS - late : len(given) - late] for late in range(LAGS + 1)])


def _noise(values: Array) -> Array:
    """Return the variance of the noise of smooth signals (m, k), from their differences of fourth order."""
    return np.asarray(DOUBT * (np.diff(values, 4, axis=0) ** 2).mean(axis=0) / 70)


def _correlations(m: int) -> tuple[Array, Array, Array]:
    """Return correlations (m, m) of means and of differences of white noise over intervals, and of white noise."""
    one, next_to = np.eye(m), np.eye(m, k=1) + np.eye(m, k=-1)
    return one / 2 + next_to / 4, 2 * one - next_to, one
