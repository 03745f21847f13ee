# SPDX-License-Identifier: Apache-2.0
"""Prove that the sampled loop contracts on a tube about a periodic reference.

Piece j of the reference has the norm |W_j chi| in error coordinates, the tube is |W_j chi| <= radius. The mean value
theorem on this ball, which is convex, gives for two solutions |W_j+1 (chi' - chi)| <= rho_j |W_j (chi' - chi)|. The
distance of the reference after one sample, d_j, makes the tube invariant if rho_j radius + d_j <= radius.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fjr_core.errors import StateError, TrajectoryError
from fjr_core.law.linearized import Indices
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.motions.reference import Reference
from fjr_core.motions.sine import Sines
from fjr_core.numerics.checks import Array, positive
from fjr_core.numerics.one_line import one_line

from ..verification.interval_matrices import ABOVE
from .error_system import ErrorSystem, period_of
from .one_sample import OneSample, Pieces, PiecewiseMetric

MOST_JOINTS = 2
LEAST_PIECES, MOST_PIECES = 3, 30_000
"""Samples in a period of the reference; more take minutes."""
SEARCHED = 24
"""Pieces on which the radius of the tube is searched before all are verified."""
RATE_SHARE = 0.9
"""The tube is the largest whose rate is at least this share of the rate near the reference."""
WEIGHTS = (30.0, 300.0, 3000.0)
"""Weights of w in the source of the metric, of which the best is taken."""
SMALLEST, LARGEST = 1e-6, 3.0
"""Extents of the smallest and the largest tube [rad, m] that are searched."""
NO_BOUND = (ZeroDivisionError, np.linalg.LinAlgError)
"""Errors where intervals become too wide."""
BISECTIONS, SHRINKS = 4, 6
Progress = Callable[[float], None]
"""Called with the share of the pieces that is verified."""
FORGOTTEN = 20.0
"""Time constants after which the start of a recursion is forgotten."""
SHARE = 0.7
"""Rate of the recursion as a share of the rate of the linearised loop."""
SOURCE = 0.4
"""Source term of the recursion, as a share of rate times sample period; little of it gives a rate near SHARE."""
CHUNK = 2048
"""Pieces that are verified together."""


@dataclass(frozen=True, eq=False)
class SampledContraction:
    """Proven contraction of the sampled loop on a tube about its reference.

    rate [1/s]: distances of any two solutions from the tube, with equal delays, fall as exp(-rate t), on average over
    each period of the reference, up to a constant factor. tube (n,) [rad, m]: largest link errors of states in the
    tube, which no solution leaves at a sample. offset (n,) [rad, m]: bound of the link errors that remain, at the
    samples and between them. least_delay, longest_delay [samples]: every delay between them is covered, also one that
    changes from sample to sample. pieces: number of pieces of the reference.
    """

    rate: float
    tube: Array
    offset: Array
    least_delay: float
    longest_delay: float
    sample_period: float
    pieces: int

    __repr__ = one_line


def sampled_contraction(
    law: TrackingLaw,
    reference: Reference,
    sample_period: float,
    delays: tuple[float, float] = (0.0, 0.0),
    on_progress: Progress = lambda share: None,
) -> SampledContraction | None:
    """Prove contraction of the law on its own robot with a sample period [s] and delays from .. to [samples].

    Returns None if no proof is found. Raises StateError for more than MOST_JOINTS joints and delays outside 0 .. 1
    sample, TrajectoryError for a reference that is no sum of sines with a common period.
    """
    positive("sample_period", sample_period, StateError)
    if law.robot.n > MOST_JOINTS:
        raise StateError(f"the law has {law.robot.n} joints; expected at most {MOST_JOINTS}, more take too long")
    if not 0 <= delays[0] <= delays[1] <= 1:
        raise StateError(f"delay is {delays[0]:g} to {delays[1]:g} samples; expected within 0 and 1")
    period = period_of(reference) or LEAST_PIECES * sample_period
    pieces = number_of_pieces(period, sample_period)
    if not LEAST_PIECES <= pieces <= MOST_PIECES:
        raise TrajectoryError(f"reference has {pieces} samples in its period; expected {LEAST_PIECES} to {MOST_PIECES}")
    assert isinstance(reference, Sines)
    proof = _Proof(OneSample(ErrorSystem(law), reference, sample_period, *delays), pieces, on_progress)
    return proof.result()


@dataclass(frozen=True, eq=False)
class _Proof:
    """The search for metric and tube on some transitions, and the proof on all of them."""

    sample: OneSample
    count: int
    on_progress: Progress

    @cached_property
    def pieces(self) -> Pieces:
        """All pieces; the centres follow the periodic solution at the middle of the delays, in floating point."""
        centre, index = np.zeros((self.count, 5 * self.sample.system.n)), np.arange(self.count)
        maps, drift = self.sample.on_centre(self.sample.pieces(index, centre))
        maps = maps.mean(axis=1)
        c, rate = np.zeros(self.sample.states), mean_rate(maps, self.sample.h)
        for _ in range(periods(rate, self.count, self.sample.h) if rate > 0 else 0):
            for j in range(self.count):
                centre[j, : len(c)] = c
                c = maps[j] @ c + drift[j]
        return self.sample.pieces(index, centre)

    @property
    def searched(self) -> Indices:
        """Transitions on which the tube is searched."""
        return np.unique(np.linspace(0, self.count - 1, SEARCHED).astype(np.intp))

    def result(self) -> SampledContraction | None:
        """Return what is proven; None if nothing is."""
        metric = self._best_metric()
        radius = None if metric is None else self._largest_radius(metric)
        if metric is None or radius is None:
            return None
        everything = np.arange(self.count + 1)
        displacement = self._displacements(metric, everything)
        for _ in range(SHRINKS):
            rho = self._factors(metric, radius, everything, self.on_progress)
            if ultimate_radius(rho, displacement) <= radius:
                return self._stated(metric, radius, rho, displacement)
            radius *= 0.8
        return None

    def _best_metric(self) -> PiecewiseMetric | None:
        """Return the metric with the highest rate near the reference."""
        law, h = self.sample.system.law, self.sample.h
        q_l = self.sample.jets(np.arange(self.count), 0.0).mid[: law.robot.n].T
        maps, _ = self.sample.on_centre(self.pieces)
        best, highest = None, 0.0
        for weight in WEIGHTS if self.sample.longest else (None,):
            metric = periodic_metric(maps, source(law, q_l, h, weight), h)
            rate = -np.inf if metric is None else self._mean_rate(self._factors(metric, 0.0, self.searched))
            if rate > 0 and rate >= highest:
                best, highest = metric, rate
        return best

    def _largest_radius(self, metric: PiecewiseMetric) -> float | None:
        """Return the radius of the largest tube that passes on the searched transitions."""
        near, displacement = self._factors(metric, 0.0, self.searched), self._displacements(metric, self.searched)
        extent = metric.extent(1.0)[:, : self.sample.system.n].max()
        radius = max(2 * ultimate_radius(near, displacement), SMALLEST / extent)

        def holds(radius: float, least: float) -> bool:
            rho = self._factors(metric, radius, self.searched)
            return ultimate_radius(rho, displacement) <= radius and self._mean_rate(rho) >= least

        least = RATE_SHARE * self._mean_rate(near)
        if not np.isfinite(radius) or not holds(radius, -np.inf):
            return None
        if not holds(radius, least):
            return radius
        step = 2.0
        while radius * step * extent < LARGEST and holds(radius * step, least):
            radius *= step
        for _ in range(BISECTIONS):
            step = np.sqrt(step)
            if holds(radius * step, least):
                radius *= step
        return float(0.95 * radius)

    def _mean_rate(self, rho: Array) -> float:
        return float(-np.mean(np.log(rho)) / self.sample.h) if np.isfinite(rho).all() else -np.inf

    def _factors(
        self, metric: PiecewiseMetric, radius: float, transitions: Indices, on_progress: Progress = lambda share: None
    ) -> Array:
        """Return contraction factors (k,) of transitions in a tube."""

        def bound(before: Indices, after: Indices) -> Array:
            return self.sample.factors(self.pieces.at(before), metric.at(before), metric.at(after), radius)

        return self._in_chunks(bound, transitions, on_progress)

    def _displacements(self, metric: PiecewiseMetric, transitions: Indices) -> Array:
        """Return displacements (k,) of the centre of the tube in transitions."""

        def bound(before: Indices, after: Indices) -> Array:
            return self.sample.displacement(self.pieces.at(before), metric.at(after), self.pieces.centre[after])

        return self._in_chunks(bound, transitions)

    def _in_chunks(
        self,
        bound: Callable[[Indices, Indices], Array],
        transitions: Indices,
        on_progress: Progress = lambda share: None,
    ) -> Array:
        """Return bounds (k, ..) of transitions, CHUNK at once: of the pieces before and after; infinite without."""
        before, after = (pieces[transitions] for pieces in transitions_of(self.count))
        bounds: list[Array] = []
        for chunk in np.array_split(np.arange(len(transitions)), -(-len(transitions) // CHUNK)):
            try:
                bounds.append(bound(before[chunk], after[chunk]))
            except NO_BOUND:
                bounds.append(np.full(len(chunk), np.inf))
            on_progress(sum(map(len, bounds)) / len(transitions))
        return np.concatenate(bounds)

    def _stated(self, metric: PiecewiseMetric, radius: float, rho: Array, displacement: Array) -> SampledContraction:
        n, decays = self.sample.system.n, -np.log(rho) / self.sample.h
        to_start, whole = np.append(decays[: self.count - 2], decays[-1]), decays[:-1]
        centre, radii = np.abs(self.pieces.centre[:, :n]), final_radii(rho, displacement)

        def until_next(piece: Indices, _: Indices) -> Array:
            flow = self.sample.flow(self.pieces.at(piece), metric.at(piece).extent(radii[piece]))
            return flow.reached[:n].T

        return SampledContraction(
            rate=float(min(to_start.mean(), whole.mean()) / ABOVE),
            tube=(centre + metric.extent(radius)[:, :n]).max(axis=0),
            offset=(centre + self._in_chunks(until_next, np.arange(self.count))).max(axis=0),
            least_delay=self.sample.least,
            longest_delay=self.sample.longest,
            sample_period=self.sample.h,
            pieces=self.count,
        )


def periodic_metric(maps: Array, source: Array, sample_period: float) -> PiecewiseMetric | None:
    """Return the metric of one-sample maps (N, v, s, s) of N pieces at v delays; None if they do not contract.

    P_j = mean of J' P_j+1 J / rho^2 + source_j, backwards until it is periodic; J of the v delays, source (N, s, s).
    """
    linear = mean_rate(maps.mean(axis=1), sample_period)
    rate = SHARE * linear
    if not rate > 0:
        return None
    transposed = np.ascontiguousarray(np.swapaxes(maps, 2, 3)) * (np.exp(2 * rate * sample_period) / maps.shape[1])
    source = SOURCE * rate * sample_period * source
    metric, P = np.empty_like(source), source[0] / (SOURCE * rate * sample_period)
    for _ in range(periods(2 * (linear - rate), len(maps), sample_period)):
        for j in range(len(maps) - 1, -1, -1):
            P = (transposed[j] @ P @ maps[j]).sum(axis=0) + source[j]
            metric[j] = P = (P + P.T) / 2
    try:
        return PiecewiseMetric.of(metric) if np.isfinite(metric).all() else None
    except np.linalg.LinAlgError:
        return None


def source(law: TrackingLaw, q_l: Array, sample_period: float, weight: float | None) -> Array:
    """Return diag(Pi_l, Pi_m, M_l, M_m), as in V, at link positions (N, n); with a weight also a block of w."""
    robot, gains, n = law.robot, law.gains, law.robot.n
    blocks = np.zeros((len(q_l), 5 * n, 5 * n))
    M_l = np.array([robot.M_l(q) for q in q_l])
    held = robot.B_m.T @ np.linalg.solve(robot.M_m, robot.B_m) * sample_period**2 * (weight or 0.0)
    for i, block in enumerate((gains.Pi_l, gains.Pi_m, M_l, robot.M_m, held)):
        blocks[:, i * n : (i + 1) * n, i * n : (i + 1) * n] = block
    return blocks if weight else blocks[:, : 4 * n, : 4 * n]


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


def number_of_pieces(period: float, h: float) -> int:
    """Return the number N of pieces of a sample period h [s] that cover a period [s] in spite of rounding."""
    return int(np.ceil(period / h * (1 + 1e-12)))


def transitions_of(pieces: int) -> tuple[Indices, Indices]:
    """Return the pieces before and after each of N + 1 transitions.

    A period of T = (N - 1) h + rest has N or N - 1 samples: piece 0 follows piece N - 1, or N - 2.
    """
    before = np.append(np.arange(pieces), pieces - 2)
    after = np.append(np.arange(1, pieces), [0, 0])
    return before, after


def ultimate_radius(rho: Array, displacement: Array) -> float:
    """Return the radius of a ball that every solution enters; infinite if some factor is not below 1."""
    return float(ABOVE * np.max(displacement / (1 - rho))) if np.all(rho < 1) else float(np.inf)


def final_radii(rho: Array, displacement: Array) -> Array:
    """Return radii (N,) of the balls that every solution is in after a while: r_j+1 = rho_j r_j + d_j."""
    r, radii = ultimate_radius(rho, displacement), np.empty(len(rho) - 1)
    for _ in range(2):
        for j in range(len(radii)):
            radii[j] = r
            r = float(ABOVE * (rho[j] * r + displacement[j]))
        r = max(r, float(ABOVE * (rho[-1] * radii[-2] + displacement[-1])))
    return radii
