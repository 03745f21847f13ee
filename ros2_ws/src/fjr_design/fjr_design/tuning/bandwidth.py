# SPDX-License-Identifier: Apache-2.0
"""Measure bandwidth and peak effort of a law; those of v-dPBC are the tuning targets of the other laws.

Bandwidth [rad/s]: T(s), T(0) = 1, is the linearised loop from the reference position to the links, at rest at the start
of the reference. The bandwidth is the lowest frequency at which the smallest singular value of M_l^1/2 T M_l^-1/2, the
gain for link motions of unit kinetic energy, is below 2^-1/2. Peak effort: the larger of the first command at the start
and the effort of the reference motion itself, as the largest share of the effort limits of the joints, or in N m if the
robot has none.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from fjr_core.config.law import START_ERROR
from fjr_core.law.gains import Gains
from fjr_core.law.interfaces import StaticLaw
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import inverse_dynamics
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_core.stability.linearization import rest_position, slope_at_rest

from ..baselines.lqr import velocity_matrices

BANDWIDTH_TOLERANCE = 0.01  # relative, of equal bandwidths
PEAK_TOLERANCE = 0.1  # relative, of equal peak efforts
GRID: Array = np.geomspace(
    0.02, 4.0, 100, dtype=float
)  # frequencies at which a bandwidth is searched, relative to the target
HORIZON = 10.0  # s of the reference whose effort is evaluated


class BaselineTarget:
    """Tuning target: bandwidth and peak effort of v-dPBC with given gains on a robot along a reference.

    start: (positions (2n,) [rad], velocities (2n,) [rad/s]) of links and motors; None: at rest with a position error of
    START_ERROR at every joint. sample_period [s]: of the loop. Raises GainsError for wrong gains, StateError for wrong
    shapes.
    """

    def __init__(
        self,
        robot: Robot,
        reference: Reference,
        gains: Gains,
        start: tuple[Array, Array] | None = None,
        sample_period: float = 1e-3,
    ) -> None:
        self.robot, self.reference, self.sample_period = robot, reference, sample_period
        self._jets = np.asarray(reference.jets(0.0))
        self.q_0 = np.array(self._jets[0])
        self.start = start or (rest_position(robot, self.q_0) + START_ERROR, np.zeros(2 * robot.n))
        self._A, self._B = velocity_matrices(robot, self.q_0)
        self._root = np.linalg.cholesky(robot.M_l(self.q_0)).T
        self._scale = _scale(robot)
        self.gains, self.law = gains, TrackingLaw(robot, gains)
        self.peak = self.peak_of(self.law)
        near = self._crossing(*self.loop(self.law), np.asarray(np.geomspace(1e-2, 1e4, 1200)))
        self.bandwidth = self._crossing(*self.loop(self.law), GRID * near)

    @cached_property
    def effort_limit(self) -> Array:
        """Common effort limit (n,) [N m]: peak effort of v-dPBC, at least 1.2 times that of the reference motion."""
        return np.asarray(self._scale * max(self.peak, 1.2 * self.reference_effort))

    def peak_of(self, law: StaticLaw) -> float:
        """Return the peak effort of a law; see the module."""
        u, _ = law.measured_command(*self.start, self._jets)
        return max(float(np.max(np.abs(u) / self._scale)), self.reference_effort)

    def same_bandwidth(self, bandwidth: float) -> bool:
        """Return whether a bandwidth [rad/s] equals the target."""
        return alike(bandwidth, self.bandwidth, BANDWIDTH_TOLERANCE)

    def same_peak(self, peak: float) -> bool:
        """Return whether a peak effort equals the target."""
        return alike(peak, self.peak, PEAK_TOLERANCE)

    def loop(self, law: StaticLaw) -> tuple[Array, Array]:
        """Return A, B of the closed loop dx/dt = A x + B dq_ld, linearised at rest at q_0."""
        F, G = slope_at_rest(law, self.q_0)
        return self._A + self._B @ F, self._B @ G

    def bandwidth_of(self, law: StaticLaw) -> float:
        """Return the bandwidth [rad/s], see the module; 0 if the loop is unstable, at most 4 times the target."""
        A, B = self.loop(law)
        if not np.linalg.eigvals(A).real.max() < 0:
            return 0.0
        return self._crossing(A, B, GRID * self.bandwidth)

    def _crossing(self, A: Array, B: Array, frequencies: Array) -> float:
        """Return the first crossing of 2^-1/2 among the frequencies [rad/s], interpolated."""
        n = self.robot.n
        s = 1j * frequencies[:, None, None]
        T = np.linalg.solve(s * np.eye(4 * n) - A, (B @ np.linalg.inv(self._root))[None].astype(complex))
        gain = np.linalg.svd(self._root @ T[:, :n], compute_uv=False)[:, -1] * 2**0.5
        below = np.flatnonzero(gain < 1)
        if not len(below) or not below[0]:
            return float(frequencies[0 if len(below) else -1])
        i = int(below[0])
        logs = np.log(gain[[i, i - 1]]), np.log(frequencies[[i, i - 1]])
        return float(np.exp(np.interp(0.0, *logs)))

    @cached_property
    def reference_effort(self) -> float:
        """Largest share of the effort limits that the reference motion requires within HORIZON."""
        times = np.linspace(0.0, min(self.reference.end, HORIZON), 200)
        motions = self.reference.jets(times).transpose(1, 2, 0)
        u = np.linalg.solve(self.robot.B_m, inverse_dynamics(self.robot)(*motions)[-1].full())
        return float(np.max(np.abs(u) / self._scale[:, None]))


def alike(one: float, other: float, tolerance: float) -> bool:
    """Return whether two nonnegative numbers are equal within a tolerance relative to `other`."""
    return abs(one - other) <= tolerance * other


def _scale(robot: Robot) -> Array:
    """Return the unit of effort (n,) [N m]: the limits of the joints, or 1 N m if not all are known."""
    limits = robot.limits
    return limits.effort if limits is not None and np.isfinite(limits.effort).all() else np.ones(robot.n)
