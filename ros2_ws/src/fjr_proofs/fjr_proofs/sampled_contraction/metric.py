# SPDX-License-Identifier: Apache-2.0
"""Find a periodic metric in which the linearised one-sample maps contract, in floating point: a proposal to verify."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core.law.linearized import Indices
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.numerics.checks import Array
from fjr_core.numerics.intervals import Interval

from ..verification.interval_matrices import ABOVE, matmul

FORGOTTEN = 20.0
"""Time constants after which the start of a recursion is forgotten."""
SHARE = 0.7
"""Rate of the recursion as a share of the rate of the linearised loop."""
SOURCE = 0.4
"""Source term of the recursion, as a share of rate times sample period; little of it gives a rate near SHARE."""


@dataclass(frozen=True, eq=False)
class Metric:
    """Norms |W[j] chi| of the pieces j, W (N, s, s), with V close to the inverse of W.

    slack (N,): |X W^-1| <= slack |X V| for every matrix X, as W^-1 = V (W V)^-1.
    """

    W: Array
    V: Array
    slack: Array

    @staticmethod
    def of(P: Array) -> Metric:
        """Return the norms (chi' P chi)^(1/2) of positive definite P (N, s, s), up to rounding."""
        W = np.ascontiguousarray(np.swapaxes(np.linalg.cholesky(P), 1, 2))
        V = np.linalg.inv(W)
        error = matmul(Interval.exact(W), Interval.exact(V)) - Interval.exact(np.eye(W.shape[-1]))
        distance = ABOVE * np.sqrt(np.sum(error.magnitude**2, axis=(1, 2)))
        return Metric(W, V, np.where(distance < 0.5, ABOVE / (1 - np.minimum(distance, 0.5)), np.inf))

    def at(self, pieces: Indices) -> Metric:
        """Return the norms of these pieces."""
        return Metric(self.W[pieces], self.V[pieces], self.slack[pieces])

    def extent(self, radius: float | Array) -> Array:
        """Return the largest |chi_i| (N, s) in the ball of this radius."""
        reach = np.sqrt(np.sum(self.V**2, axis=2))
        return np.asarray(ABOVE * self.slack[:, None] * np.reshape(radius, (-1, 1)) * reach)


def periodic_metric(maps: Array, source: Array, sample_period: float) -> Metric | None:
    """Return the metric of one-sample maps (N, v, s, s) of N pieces at v delays; None if they do not contract.

    P_j = mean of J' P_j+1 J / rho^2 + source_j, backwards until it is periodic; J of the v delays, source (N, s, s).
    """
    linear = mean_rate(maps.mean(axis=1), sample_period)
    rate = SHARE * linear
    if not rate > 0:
        return None
    transposed = np.ascontiguousarray(np.swapaxes(maps, 2, 3)) * (np.exp(2 * rate * sample_period) / maps.shape[1])
    source = SOURCE * rate * sample_period * source
    found, P = np.empty_like(source), source[0] / (SOURCE * rate * sample_period)
    for _ in range(periods(2 * (linear - rate), len(maps), sample_period)):
        for j in range(len(maps) - 1, -1, -1):
            P = (transposed[j] @ P @ maps[j]).sum(axis=0) + source[j]
            found[j] = P = (P + P.T) / 2
    try:
        return Metric.of(found) if np.isfinite(found).all() else None
    except np.linalg.LinAlgError:
        return None


def source(law: TrackingLaw, q_l: Array, sample_period: float, weight: float | None) -> Array:
    """Return diag(Pi_l, Pi_m, M_l, M_m), as in V, at link positions (N, n); with a weight also a block of w."""
    robot, gains, n = law.robot, law.gains, law.robot.n
    found = np.zeros((len(q_l), 5 * n, 5 * n))
    M_l = np.array([robot.M_l(q) for q in q_l])
    held = robot.B_m.T @ np.linalg.solve(robot.M_m, robot.B_m) * sample_period**2 * (weight or 0.0)
    for i, block in enumerate((gains.Pi_l, gains.Pi_m, M_l, robot.M_m, held)):
        found[:, i * n : (i + 1) * n, i * n : (i + 1) * n] = block
    return found if weight else found[:, : 4 * n, : 4 * n]


def periods(rate: float, pieces: int, sample_period: float) -> int:
    """Return the number of periods after which a recursion with a decay rate [1/s] has forgotten its start."""
    return 1 + int(np.ceil(FORGOTTEN / (rate * pieces * sample_period)))


def mean_rate(maps: Array, sample_period: float) -> float:
    """Return the mean rate [1/s] of the product of maps (N, s, s) over one period."""
    product, logarithm = np.eye(maps.shape[-1]), 0.0
    for J in maps:
        product = J @ product
        size = np.linalg.norm(product)
        product, logarithm = product / size, logarithm + np.log(size)
    radius = np.abs(np.linalg.eigvals(product)).max()
    return float(-(logarithm + np.log(radius)) / (len(maps) * sample_period))
