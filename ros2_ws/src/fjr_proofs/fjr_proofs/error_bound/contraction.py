# SPDX-License-Identifier: Apache-2.0
"""Prove that any two motions of the sampled loop in a tube, with equal delays, approach each other at a rate.

The difference y of two motions in the tube obeys the linear model of its cell, disturbed by at most |X| |y|, with X the
ranges of the slopes in the tube. With y_k = exp(-rate t_k) Y_k the bounds of the tube apply to Y: loop and inputs are
multiplied by exp(rate T). What acts at an instant is up to delay + 2 T older than the nearest sample: the bounds of its
effects are multiplied by exp(rate (delay + 2 T)). Bounds that reproduce themselves under a positive disturbance then
exist only if the mismatch makes no Y grow, so that |y| <= c exp(-rate t).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np

from fjr_core.errors import StateError, TrajectoryError
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.motions.reference import Reference
from fjr_core.motions.sine import Sines
from fjr_core.numerics.checks import Array, kind_of, positive, vector
from fjr_core.numerics.one_line import one_line

from .deviation_model import DeviationModel
from .enclosures import Mismatch, Ranges
from .known_response import Response, course
from .search import Search
from .tube import DeviationBounds, Known, TubeProblem, fixed_point

SHARES = (0.95, 0.9, 0.8, 0.65, 0.5, 0.3, 0.1)
"""Rates near the reference that are tried, as shares of that of the linear loop."""
RATE_SHARE = 0.9
"""The rate in the tube as a share of the rate near the reference: a smaller rate has a larger tube."""
SMALLEST, LARGEST = 1e-6, 3.0
"""Link errors [rad, m] of the smallest start, and of those up to which starts grow by FACTOR."""
FACTOR, BISECTIONS = 4.0, 4  # ratio of two starts; bisections of its logarithm
SMALL = 1e-6
"""Disturbance under which the bounds of a difference are sought; every size gives the same answer."""

Progress = Callable[[float], None]
"""Called with the share of the search for the largest start that is done."""


@dataclass(frozen=True, eq=False)
class SampledContraction:
    """Proven contraction of the sampled loop on a tube about its reference.

    rate [1/s]: distances of any two motions in the tube with equal delays fall as c exp(-rate t). tube (n,) [rad, m]:
    starts at time 0 with link errors up to these, of all joints together, do not leave the tube. offset (n,) [rad, m]:
    bound of the link errors that remain. least_delay, longest_delay [samples]: every delay between them is covered,
    also one that changes from sample to sample.
    """

    rate: float
    tube: Array
    offset: Array
    least_delay: float
    longest_delay: float
    sample_period: float

    __repr__ = one_line


def sampled_contraction(
    law: TrackingLaw,
    reference: Reference,
    sample_period: float,
    delays: tuple[float, float] | float = (0.0, 0.0),
    on_progress: Progress = lambda share: None,
) -> SampledContraction | None:
    """Prove contraction of the law on its own robot with a sample period [s] and delays from .. to [samples].

    One number is a constant delay. Returns None if no proof is found. Raises StateError for delays outside 0 .. 1
    sample, TrajectoryError for a reference without sines, ParameterError for sines without a period within 60 s.
    """
    positive("sample_period", sample_period, StateError)
    least, most = vector("delays", delays, 2, StateError).tolist()
    if not 0 <= least <= most <= 1:
        raise StateError(f"delay is {least:g} to {most:g} samples; expected within 0 and 1")
    if not isinstance(reference, Sines):
        raise TrajectoryError(f"reference is {kind_of(reference)}; expected sines, whose derivatives are enclosed")
    n, middle, none = law.robot.n, sample_period * (least + most) / 2, np.zeros(0)
    late = sample_period * (most - least) / 2
    search = Search(DeviationModel(law), reference, sample_period, middle, np.zeros(2 * n), verified=True, late=late)
    linear = search.linear(none)
    problem = search.problem(linear, none, none)
    if problem is None:
        return None
    fastest = float(-np.log(linear.spectral_radius) / sample_period)
    for share in SHARES:
        if _pairs(search, problem, share * fastest, few=True) is not None:
            found = _pairs(search, problem, RATE_SHARE * share * fastest)
            if found is not None:
                return found.widest((least, most), on_progress)
    return None


def _pairs(search: Search, problem: TubeProblem, rate: float, few: bool = False) -> Pairs | None:
    """Return the pairs that approach each other at a rate [1/s] if they start close to the reference; else None.

    few: see Search.gains; the result is no proof, but quick.
    """
    gains = search.gains(problem.linear, rate, few)
    if gains is None:
        return None
    peaks, blocks = gains
    given = problem.ranges
    found = Pairs(problem, Ranges(problem.linear, given.low, given.high, blocks), rate, peaks)
    return None if found.approach(SMALLEST) is None else found


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of motions that start near the reference.

    gains: of exp(rate t) Z. ranges: of the slopes in windows that hold the sums of these gains, which are longer.
    """

    problem: TubeProblem
    ranges: Ranges
    rate: float
    gains: Array

    def widest(self, delays: tuple[float, float], on_progress: Progress) -> SampledContraction:
        """Return the contraction for the largest start that is found; the smallest one has a tube."""
        size, factor = SMALLEST, FACTOR
        while size * factor < LARGEST and self.approach(size * factor) is not None:
            size *= factor
            on_progress(np.log(size / SMALLEST) / np.log(LARGEST / SMALLEST))
        for _ in range(BISECTIONS):
            factor = np.sqrt(factor)
            if self.approach(size * factor) is not None:
                size *= factor
        on_progress(1.0)
        tube, linear = self.approach(size), self.problem.linear
        assert tube is not None
        final = self.problem.steady.positions_and_velocities(self.problem.shrunk(tube))[: linear.n]
        S, n = linear.coordinates, linear.n
        start = np.abs(S.S_inverse[:n]) @ self._shape
        start *= np.min(self._shape[:n] / (np.abs(S.S[:n, :n]) @ start))  # all joints together within the modal box
        offset = linear.centre.largest[: linear.n] + final
        return SampledContraction(self.rate, size * start, offset, *delays, linear.sample_period)

    def approach(self, size: float) -> DeviationBounds | None:
        """Return the tube of starts with link errors up to a size [rad, m], if motions in it approach each other."""
        try:
            started = [replace(known, rest=known.rest.plus(self._decay, size)) for known in self.problem.started]
            tube, few = self.problem.grown(*started), [known.sparse for known in started]
            return tube if tube is not None and all(self._approach_in(tube, each) for each in (few, started)) else None
        except ZeroDivisionError:  # a divisor may be zero: the tube is too wide
            return None

    def _approach_in(self, tube: DeviationBounds, started: list[Known]) -> bool:
        linear = self.problem.linear
        acceleration = np.abs(linear.coordinates.acceleration) @ tube.acceleration
        small = np.full((5 if linear.late else 4) * linear.n, SMALL)
        found: list[Mismatch] = []
        for known in started:
            mismatch = self.ranges.of(known.ranges.at).mismatch(
                tube.z, small, known.lines, known.accelerations, acceleration
            )
            if mismatch is None:
                return False
            found.append(mismatch)
        oldest = linear.delay + 2 * linear.sample_period  # of what acts, before the nearest sample
        return (
            fixed_point(linear, self.gains, reduce(Mismatch.most, found), aged=float(np.exp(self.rate * oldest)))
            is not None
        )

    @cached_property
    def _shape(self) -> Array:
        """Deviations (4n,) of a start: those that equal link torques can cause, with a largest link error of 1."""
        n, linear = self.problem.linear.n, self.problem.linear
        caused = self.problem.gains[: 4 * n, :n].sum(axis=1)
        return np.asarray(caused / np.max(np.abs(linear.coordinates.S_inverse[:n]) @ caused))

    @cached_property
    def _decay(self) -> Response:
        """Response to the start: each deviation, and each effort in transit, that of the law, with either sign."""
        linear, states = self.problem.linear, len(self.problem.steady.whole.Z[0])
        efforts = np.abs(linear.law).max(axis=0) @ self._shape
        transit = np.tile(efforts, (states - 4 * linear.n) // linear.n)
        cells = np.arange(self.problem.ranges.blocks) % linear.centre.cells.count
        decay = course(linear, np.diag(np.append(self._shape, transit)), cells)
        return decay._replace(remaining=np.abs(decay.Z).sum(axis=2).max(axis=0))
