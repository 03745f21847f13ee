# SPDX-License-Identifier: Apache-2.0
"""One law on one robot along one reference, run under any imperfections: every cell an independent run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...numerics.checks import Array
from ...simulation.batch import ClosedLoop, Draws, Outcomes, Recorded
from ...simulation.batch.draws import PER_RUN
from .motion_demand import Needs
from .perturbations import Direction, Fields, bearable, known
from .robustness_margins import Edge, Levels, search

TRACKS = 0.1  # of the motion
Levels_of = Mapping[str, float]


@dataclass(frozen=True)
class Cell:
    """Metrics of one run, after the start where Outcomes has them so; of all joints together.

    rms [rad]: RMS over time and joints of q_l - q_ld; relative: that as a part of the motion's own RMS (Needs.motion).
    peak [rad]: of the worst joint. settling [s]. effort_rms [N m]: over time and joints; effort_peak [N m]: of any
    joint. power [W]: mean of |u' dq_m|. steady [rad]: mean error of the last second, of the worst joint.
    Of a run that is not stable all of them are None.
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


@dataclass
class Trial:
    """A closed loop with what its motion needs.

    effort_limit (n,) [N m]: where commands are cut; inf: nowhere. tracks: a run tracks when it is stable and its RMS
    error is at most this part of the motion's RMS; one number for all laws. seed: of the noise, the same in every run.
    looked_at: (axis, level) of every run so far -> its cell.
    """

    loop: ClosedLoop
    needs: Needs
    effort_limit: ArrayLike = np.inf
    tracks: float = TRACKS
    seed: int = 0
    looked_at: dict[tuple[str, float], Cell] = field(default_factory=dict)

    def cells(self, imperfections: Sequence[Levels_of]) -> list[Cell]:
        """A run each; an imperfection is levels by the names of AXES, {} for the nominal plant."""
        outcomes = self.loop.run(self._draws(imperfections))
        return [self._cell(outcomes, i) for i in range(len(imperfections))]

    def margins(self, directions: Sequence[Direction]) -> dict[str, Edge]:
        """The largest level of each imperfection up to which the loop tracks."""
        return search(self._judge, directions)

    def curve(self, axis: str) -> tuple[Array, list[Cell]]:
        """All levels of an axis that the search for margins looked at, in order, with their cells."""
        levels = sorted(level for name, level in self.looked_at if name == axis)
        return np.array(levels), [self.looked_at[axis, level] for level in levels]

    def recorded(self) -> Recorded:
        """The nominal run, sample by sample."""
        return self.loop.recorded(self._draws([{}]))[1]

    def _judge(self, levels: Levels) -> NDArray[np.bool_]:
        new = [key for key in dict.fromkeys(levels) if key not in self.looked_at]
        cells = self.cells([{axis: level} for axis, level in new]) if new else []
        self.looked_at |= dict(zip(new, cells, strict=True))
        return np.array([self.looked_at[key].tracks for key in levels])

    def _draws(self, imperfections: Sequence[Levels_of]) -> Draws:
        """A row of each field for every run; where a run has no such imperfection, the nominal one."""
        fields = [self._fields(imperfection) for imperfection in imperfections]
        names = {name for each in fields for name in each}
        nominal = Draws(1)
        columns = {
            name: np.stack([np.asarray(each.get(name, getattr(nominal, name))) + self._zeros(name) for each in fields])
            for name in names
        }
        limit = np.broadcast_to(self.effort_limit, (len(imperfections), self.loop.robot.n))
        return Draws(len(imperfections), seed=self.seed, effort_limit=limit, **columns)

    def _fields(self, imperfection: Levels_of) -> Fields:
        step = self.loop.sample_period / self.loop.inner_steps
        levels = {known(name): level for name, level in imperfection.items()}
        parts = [axis.fields(level, self.needs, step) for axis, level in levels.items()]
        return bearable({key: value for part in parts for key, value in part.items()})

    def _zeros(self, name: str) -> Array:
        return np.zeros(() if name in PER_RUN else self.loop.robot.n)

    def _cell(self, outcomes: Outcomes, i: int) -> Cell:
        if not outcomes.stable[i]:
            return Cell(stable=False, tracks=False)
        rms = _over_joints(outcomes.rms[i])
        relative = rms / self.needs.motion
        return Cell(
            stable=True,
            tracks=bool(relative <= self.tracks),
            rms=rms,
            relative=relative,
            peak=float(np.max(outcomes.peak[i])),
            settling=float(outcomes.settling[i]) if np.isfinite(outcomes.settling[i]) else None,
            effort_rms=_over_joints(outcomes.effort_rms[i]),
            effort_peak=float(np.max(outcomes.effort_peak[i])),
            power=float(outcomes.power[i]),
            steady=float(np.max(np.abs(outcomes.final[i]))),
        )


def _over_joints(rms: Array) -> float:
    return float(np.sqrt(np.mean(np.square(rms))))
