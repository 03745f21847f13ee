# SPDX-License-Identifier: Apache-2.0
"""Run one law on one robot along one reference with given imperfections, and search its robustness margins.

A margin is found by increasing an imperfection until tracking fails, and refining around that level.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.numerics.checks import Array
from fjr_design.batch import ClosedLoop, Draws, Outcomes, Recorded
from fjr_design.batch.draws import PARAMETERS

from .imperfections import Direction, MotionDemand, fields_of
from .sweep import figures

TRACKS = 0.1  # largest RMS error of a tracking run, relative to the RMS motion
STEPS = 16  # levels of the first scan, evenly spaced on a logarithmic scale
PARTS = 7  # levels of each refinement
ROUNDS = 2  # of refinement
Levels = Sequence[tuple[str, float]]
Evaluation = Callable[[Levels], NDArray[np.bool_]]
"""(imperfection, level) of k runs -> whether each run tracks (k,)."""


@dataclass(frozen=True)
class RobustnessMargin:
    """Margin in one direction.

    level: largest level such that it and all tested levels below track; None if the nominal one does not. beyond: the
    next tested level, which does not track; None if all levels track.
    """

    level: float | None
    beyond: float | None


def margins(tracks: Evaluation, directions: Sequence[Direction]) -> dict[str, RobustnessMargin]:
    """Return the margins in all directions by name.

    tracks: evaluates all levels of a scan at once. The search stops at the first level that fails; larger levels that
    track again are ignored, because a robot may have any level in between.
    """
    ladders = {direction.name: direction.ladder(STEPS) for direction in directions}
    found = _scan(tracks, directions, ladders)
    for _ in range(ROUNDS):
        finer = {
            name: _between(one.level, one.beyond) for name, one in found.items() if one.level is not None and one.beyond
        }
        found |= _scan(tracks, [d for d in directions if d.name in finer], finer)
    return found


def _scan(
    tracks: Evaluation, directions: Sequence[Direction], ladders: Mapping[str, Array]
) -> dict[str, RobustnessMargin]:
    """Return the margins on ladders (levels,) of levels, which are evaluated at once."""
    levels = [(d.imperfection.name, float(level)) for d in directions for level in ladders[d.name]]
    results = iter(tracks(levels).tolist() if levels else ())
    found = {}
    for direction in directions:
        ladder = ladders[direction.name].tolist()
        each = [next(results) for _ in ladder]
        failed = each.index(False) if False in each else len(each)
        found[direction.name] = RobustnessMargin(
            ladder[failed - 1] if failed else None, ladder[failed] if failed < len(each) else None
        )
    return found


def _between(low: float, high: float) -> Array:
    """Return both ends of a margin and PARTS levels between them."""
    spaced = np.linspace if low == 0.0 else np.geomspace
    return np.asarray(spaced(low, high, PARTS + 2), dtype=float)


@dataclass(frozen=True)
class RunMetrics:
    """Metrics of one run over all joints; errors count after settle_after, see Outcomes.

    rms [rad]: RMS over time and joints of q_l - q_ld; relative: rms divided by the RMS of the motion. peak [rad]: of
    the worst joint. settling [s]. effort_rms [N m]: over time and joints; effort_peak [N m]: of any joint. power [W]:
    mean of |u' dq_m|. steady [rad]: mean error of the worst joint over the last second. All are None for a run that is
    not stable. stopped: the limit that stopped the controller, None if none did; such a run does not track.
    """

    stable: bool
    tracks: bool
    rms: float | None = None
    relative: float | None = None
    peak: float | None = None
    settling: float | None = None
    effort_rms: float | None = None
    effort_peak: float | None = None
    power: float | None = None
    steady: float | None = None
    stopped: str | None = None


@dataclass
class Trial:
    """Closed loop with the demand of its motion.

    effort_limit (n,) [N m]: saturation of commands; inf: none. tracks: a run tracks if it is stable and its RMS error
    is at most this fraction of the RMS motion; the same for all laws. seed: of the noise, the same in every run.
    evaluated: (imperfection, level) of all runs so far -> metrics.
    """

    loop: ClosedLoop
    demand: MotionDemand
    effort_limit: ArrayLike = np.inf
    tracks: float = TRACKS
    seed: int = 0
    evaluated: dict[tuple[str, float], RunMetrics] = field(default_factory=dict)

    def metrics(self, runs: Sequence[Mapping[str, float]]) -> list[RunMetrics]:
        """Return the metrics of one run per item: levels by the names of IMPERFECTIONS, {} for the nominal plant."""
        outcomes = self.loop.run(self.draws(runs))
        found = figures(outcomes, outcomes.stable)
        each = [{name: float(values[i]) for name, values in found.items()} for i in range(len(runs))]
        return [self._metrics(outcomes, i, of) for i, of in enumerate(each)]

    def margins(self, directions: Sequence[Direction]) -> dict[str, RobustnessMargin]:
        """Return the largest level of each imperfection up to which the loop tracks."""
        return margins(self._track, directions)

    def curve(self, imperfection: str) -> tuple[Array, list[RunMetrics]]:
        """Return all evaluated levels of an imperfection in increasing order, with their metrics."""
        levels = sorted(level for name, level in self.evaluated if name == imperfection)
        return np.array(levels), [self.evaluated[imperfection, level] for level in levels]

    def recorded(self) -> Recorded:
        """Return the samples of the nominal run."""
        return self.loop.recorded(self.draws([{}]))[1]

    def draws(self, runs: Sequence[Mapping[str, float]]) -> Draws:
        """Return the draws of runs with these imperfections; fields that none of them changes are nominal."""
        n, step = self.loop.robot.n, self.loop.sample_period / self.loop.inner_steps
        fields = [fields_of(levels, self.demand, step) for levels in runs]
        nominal, columns = Draws(1), {}
        for name in {name for each in fields for name in each}:
            zeros = np.zeros(() if PARAMETERS[name].per_run else n)
            columns[name] = np.stack([np.asarray(each.get(name, getattr(nominal, name))) + zeros for each in fields])
        limit = np.broadcast_to(self.effort_limit, (len(runs), n))
        return Draws(len(runs), seed=self.seed, effort_limit=limit, **columns)

    def _track(self, levels: Levels) -> NDArray[np.bool_]:
        new = [key for key in dict.fromkeys(levels) if key not in self.evaluated]
        cells = self.metrics([{name: level} for name, level in new]) if new else []
        self.evaluated |= dict(zip(new, cells, strict=True))
        return np.array([self.evaluated[key].tracks for key in levels])

    def _metrics(self, outcomes: Outcomes, i: int, of: Mapping[str, float]) -> RunMetrics:
        if not outcomes.stable[i]:
            return RunMetrics(stable=False, tracks=False)
        relative, stopped = of["rms"] / self.demand.motion, str(outcomes.cause[i]) or None
        return RunMetrics(
            stable=True,
            tracks=relative <= self.tracks and not stopped,
            relative=relative,
            settling=float(outcomes.settling[i]) if np.isfinite(outcomes.settling[i]) else None,
            steady=of["final"],
            stopped=stopped,
            **{name: of[name] for name in ("rms", "peak", "effort_rms", "effort_peak", "power")},
        )
