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
from .error_system import ErrorSystem
from .metric import Metric, mean_rate, periodic_metric, periods, source
from .one_sample import OneSample
from .pieces import Pieces, chunks, final_radii, joined, number_of_pieces, transitions_of, ultimate_radius
from .sine_jets import period_of

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
    _check(law, sample_period, delays)
    period = period_of(reference) or LEAST_PIECES * sample_period
    pieces = number_of_pieces(period, sample_period)
    if not LEAST_PIECES <= pieces <= MOST_PIECES:
        raise TrajectoryError(f"reference has {pieces} samples in its period; expected {LEAST_PIECES} to {MOST_PIECES}")
    assert isinstance(reference, Sines)
    proof = _Proof(OneSample(ErrorSystem(law), reference, sample_period, *delays), pieces, on_progress)
    return proof.result()


def _check(law: TrackingLaw, sample_period: float, delays: tuple[float, float]) -> None:
    positive("sample_period", sample_period, StateError)
    if law.robot.n > MOST_JOINTS:
        raise StateError(f"the law has {law.robot.n} joints; expected at most {MOST_JOINTS}, more take too long")
    if not 0 <= delays[0] <= delays[1] <= 1:
        raise StateError(f"delay is {' to '.join(f'{each:g}' for each in delays)} samples; expected within 0 and 1")


@dataclass(frozen=True, eq=False)
class _Proof:
    """The search for metric and tube on some transitions, and the proof on all of them."""

    sample: OneSample
    pieces: int
    on_progress: Progress

    @cached_property
    def nodes(self) -> Pieces:
        """All pieces; the centres follow the periodic solution at the middle of the delays, in floating point."""
        zero = self._pieces(np.zeros((self.pieces, 5 * self.sample.system.n)))
        maps, drift = self._on_centre(zero)
        maps, centre = maps.mean(axis=1), np.zeros_like(zero.centre)
        c, rate = np.zeros(self.sample.states), mean_rate(maps, self.sample.h)
        for _ in range(periods(rate, self.pieces, self.sample.h) if rate > 0 else 0):
            for j in range(self.pieces):
                centre[j, : len(c)] = c
                c = maps[j] @ c + drift[j]
        return self._pieces(centre)

    def _pieces(self, centre: Array) -> Pieces:
        return joined([self.sample.pieces(part, centre[part]) for part in chunks(np.arange(self.pieces))])

    def _on_centre(self, pieces: Pieces) -> tuple[Array, Array]:
        parts = [self.sample.on_centre(pieces.at(part)) for part in chunks(np.arange(self.pieces))]
        maps, drift = zip(*parts, strict=True)
        return np.concatenate(maps), np.concatenate(drift)

    @property
    def searched(self) -> Indices:
        """Transitions on which the tube is searched."""
        return np.unique(np.linspace(0, self.pieces - 1, SEARCHED).astype(np.intp))

    def result(self) -> SampledContraction | None:
        """Return what is proven; None if nothing is."""
        metric = self._best_metric()
        radius = None if metric is None else self._largest_radius(metric)
        if metric is None or radius is None:
            return None
        everything = np.arange(self.pieces + 1)
        displacement = self._displacements(metric, everything)
        for _ in range(SHRINKS):
            rho = self._factors(metric, radius, everything, self.on_progress)
            if ultimate_radius(rho, displacement) <= radius:
                return self._stated(metric, radius, rho, displacement)
            radius *= 0.8
        return None

    def _best_metric(self) -> Metric | None:
        """Return the metric with the highest rate near the reference."""
        q_l = self.sample.jets(np.arange(self.pieces), 0.0).mid[: self.sample.system.n].T
        maps, _ = self._on_centre(self.nodes)
        law, h = self.sample.system.law, self.sample.h
        sources = [source(law, q_l, h, weight) for weight in (WEIGHTS if self.sample.longest else (None,))]
        found = [metric for metric in (periodic_metric(maps, each, h) for each in sources) if metric is not None]
        rated = [(self._rate_near(metric), i) for i, metric in enumerate(found)]
        return found[max(rated)[1]] if rated and max(rated)[0] > 0 else None

    def _rate_near(self, metric: Metric) -> float:
        return self._mean_rate(self._factors(metric, 0.0, self.searched))

    def _largest_radius(self, metric: Metric) -> float | None:
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
        self, metric: Metric, radius: float, transitions: Indices, on_progress: Progress = lambda share: None
    ) -> Array:
        """Return contraction factors (k,) of transitions in a tube."""
        rho: list[Array] = []
        for part in chunks(transitions):
            before, after = (pieces[part] for pieces in transitions_of(self.pieces))
            try:
                rho.append(self.sample.factors(self.nodes.at(before), metric.at(before), metric.at(after), radius))
            except NO_BOUND:
                rho.append(np.full(len(part), np.inf))
            on_progress(sum(map(len, rho)) / len(transitions))
        return np.concatenate(rho)

    def _displacements(self, metric: Metric, transitions: Indices) -> Array:
        """Return displacements (k,) of the centre of the tube in transitions."""
        found = []
        for part in chunks(transitions):
            before, after = (pieces[part] for pieces in transitions_of(self.pieces))
            pieces, centre = self.nodes.at(before), self.nodes.centre[after]
            try:
                found.append(self.sample.displacement(pieces, metric.at(after), centre))
            except NO_BOUND:
                found.append(np.full(len(part), np.inf))
        return np.concatenate(found)

    def _stated(self, metric: Metric, radius: float, rho: Array, displacement: Array) -> SampledContraction:
        n, decays = self.sample.system.n, -np.log(rho) / self.sample.h
        to_start, whole = np.append(decays[: self.pieces - 2], decays[-1]), decays[:-1]
        centre = np.abs(self.nodes.centre[:, :n])
        between = self._between_samples(metric, final_radii(rho, displacement))
        return SampledContraction(
            rate=float(min(to_start.mean(), whole.mean()) / ABOVE),
            tube=(centre + metric.extent(radius)[:, :n]).max(axis=0),
            offset=(centre + between).max(axis=0),
            least_delay=self.sample.least,
            longest_delay=self.sample.longest,
            sample_period=self.sample.h,
            pieces=self.pieces,
        )

    def _between_samples(self, metric: Metric, radii: Array) -> Array:
        """Return bounds (N, n) of the link errors, less the centre, until a sample after those with radii (N,)."""
        found = []
        for part in chunks(np.arange(self.pieces)):
            flow = self.sample.flow(self.nodes.at(part), metric.at(part).extent(radii[part]))
            found.append(flow.reached[: self.sample.system.n].T)
        return np.concatenate(found)
