# SPDX-License-Identifier: Apache-2.0
"""Run one law on one robot along one reference under given perturbations, as independent runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.numerics.checks import Array
from fjr_core.simulation.batch import ClosedLoop, Draws, Outcomes, Recorded
from fjr_core.simulation.batch.draws import PER_RUN

from .motion_demand import MotionDemand
from .perturbations import Direction, Fields, known, numerically_stable
from .robustness_margins import Levels, RobustnessMargin, search

TRACKS = 0.1  # largest RMS error of a tracking run, relative to the RMS motion
LevelByName = Mapping[str, float]


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
    evaluated: (perturbation, level) of all runs so far -> metrics.
    """

    loop: ClosedLoop
    demand: MotionDemand
    effort_limit: ArrayLike = np.inf
    tracks: float = TRACKS
    seed: int = 0
    evaluated: dict[tuple[str, float], RunMetrics] = field(default_factory=dict)

    def metrics(self, perturbations: Sequence[LevelByName]) -> list[RunMetrics]:
        """Return the metrics of one run per item: levels by the names of PERTURBATIONS, {} for the nominal plant."""
        outcomes = self.loop.run(self._draws(perturbations))
        return [self._metrics(outcomes, i) for i in range(len(perturbations))]

    def margins(self, directions: Sequence[Direction]) -> dict[str, RobustnessMargin]:
        """Return the largest level of each perturbation up to which the loop tracks."""
        return search(self._track, directions)

    def curve(self, perturbation: str) -> tuple[Array, list[RunMetrics]]:
        """Return all evaluated levels of a perturbation in increasing order, with their metrics."""
        levels = sorted(level for name, level in self.evaluated if name == perturbation)
        return np.array(levels), [self.evaluated[perturbation, level] for level in levels]

    def recorded(self) -> Recorded:
        """Return the samples of the nominal run."""
        return self.loop.recorded(self._draws([{}]))[1]

    def _track(self, levels: Levels) -> NDArray[np.bool_]:
        new = [key for key in dict.fromkeys(levels) if key not in self.evaluated]
        cells = self.metrics([{name: level} for name, level in new]) if new else []
        self.evaluated |= dict(zip(new, cells, strict=True))
        return np.array([self.evaluated[key].tracks for key in levels])

    def _draws(self, perturbations: Sequence[LevelByName]) -> Draws:
        """Return the draws of all runs; fields without a perturbation are nominal."""
        fields = [self._fields(perturbation) for perturbation in perturbations]
        names = {name for each in fields for name in each}
        nominal = Draws(1)
        columns = {
            name: np.stack([np.asarray(each.get(name, getattr(nominal, name))) + self._zeros(name) for each in fields])
            for name in names
        }
        limit = np.broadcast_to(self.effort_limit, (len(perturbations), self.loop.robot.n))
        return Draws(len(perturbations), seed=self.seed, effort_limit=limit, **columns)

    def _fields(self, perturbation: LevelByName) -> Fields:
        step = self.loop.sample_period / self.loop.inner_steps
        levels = {known(name): level for name, level in perturbation.items()}
        parts = [one.fields(level, self.demand, step) for one, level in levels.items()]
        return numerically_stable({key: value for part in parts for key, value in part.items()})

    def _zeros(self, name: str) -> Array:
        return np.zeros(() if name in PER_RUN else self.loop.robot.n)

    def _metrics(self, outcomes: Outcomes, i: int) -> RunMetrics:
        if not outcomes.stable[i]:
            return RunMetrics(stable=False, tracks=False)
        rms, stopped = _over_joints(outcomes.rms[i]), str(outcomes.cause[i]) or None
        relative = rms / self.demand.motion
        return RunMetrics(
            stable=True,
            tracks=bool(relative <= self.tracks) and not stopped,
            rms=rms,
            relative=relative,
            peak=float(np.max(outcomes.peak[i])),
            settling=float(outcomes.settling[i]) if np.isfinite(outcomes.settling[i]) else None,
            effort_rms=_over_joints(outcomes.effort_rms[i]),
            effort_peak=float(np.max(outcomes.effort_peak[i])),
            power=float(outcomes.power[i]),
            steady=float(np.max(np.abs(outcomes.final[i]))),
            stopped=stopped,
        )


def _over_joints(rms: Array) -> float:
    return float(np.sqrt(np.mean(np.square(rms))))
