# SPDX-License-Identifier: Apache-2.0
"""Reference trajectory of a bag with its four derivatives.

The scenario's reference is used where it was tracked; elsewhere the recorded one is differentiated numerically.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.scenario import Scenario
from fjr_core.motions.reference import JETS
from fjr_monitor.analysis.commands import match_stamps
from fjr_monitor.analysis.states import first_of_each_stamp
from fjr_monitor.recording.reader import Array, JointTable, Times
from fjr_msgs_py import names

REFERENCE = names.REFERENCE.replace("~", f"/{names.CONTROLLER}")
SAME = 1e-9  # rad, rad/s, relative to the size of the reference: resolution of stamps in ns
DEGREE = 5  # of the spline through the recorded velocities: its third derivative is d4q_ld


class RecordedReference:
    """The tracked reference of a run that comes in parts. mismatch [rad]: recorded minus planned; NaN: unknown."""

    def __init__(self, scenario: Scenario) -> None:
        self._planned = scenario.reference
        self._size = np.ones(2)  # 1 plus the largest position and velocity
        self._since: int | None = None  # stamp [ns] of the first state with another reference than the scenario's
        self._start: float | None = None
        self.mismatch = float("nan")

    def jets(self, table: JointTable | None, stamp: Times, t: Array) -> Array:
        """Return q_ld .. d4q_ld (k, 5, n) at the stamps [ns], which are t (k,) [s] after the first state.

        table: the recorded reference about these stamps; stamps may repeat those of the part before.
        """
        planned = self._planned.jets(t)
        if table is None or not len(table.stamp) or not len(t):
            return planned
        rows = first_of_each_stamp(table.stamp)
        place, found = match_stamps(stamp, table.stamp[rows])
        position, velocity = table.position[rows][place], table.velocity[rows][place]
        if not np.isfinite(position[found]).any():
            return planned
        deviation = np.abs(position - planned[:, 0]).max(axis=1)[found]
        self.mismatch = float(np.maximum(np.nan_to_num(self.mismatch), deviation.max(initial=0.0)))
        self._size = np.maximum(self._size, 1.0 + np.abs(planned[:, :2]).max(axis=(0, 2)))
        apart = np.abs(np.stack([position, velocity], axis=1) - planned[:, :2])
        differs = found & ~(apart <= SAME * self._size[:, None]).all(axis=(1, 2))
        if self._since is None and differs.any():
            self._since = int(stamp[np.argmax(differs)])
        if self._since is None:
            return planned
        usable = found & np.isfinite(position).all(axis=1) & np.isfinite(velocity).all(axis=1) & (stamp >= self._since)
        return self._numerical(planned, t, np.flatnonzero(usable), position, velocity)

    def _numerical(self, planned: Array, t: Array, rows: NDArray[np.intp], position: Array, velocity: Array) -> Array:
        """Replace the jets from the first of `rows` on by derivatives of splines through the recorded reference."""
        if len(rows) <= DEGREE:
            return planned
        from scipy.interpolate import make_interp_spline  # loaded on use: a fifth of the imports of `fjr run`

        self._start = t[rows[0]] if self._start is None else self._start
        since = slice(rows[0], None)
        planned, inside = planned.copy(), np.clip(t[since], t[rows[0]], t[rows[-1]])
        planned[since, 0] = make_interp_spline(t[rows], position[rows], k=DEGREE)(inside)
        curve = make_interp_spline(t[rows], velocity[rows], k=DEGREE)
        for order in range(1, JETS):
            planned[since, order] = curve(inside, order - 1)
        return planned

    def notes(self, recorded: bool) -> tuple[str, ...]:
        """Return a sentence on what was taken, once all parts were read; recorded: whether the bag holds the topic."""
        if not recorded:
            return (
                f"{REFERENCE} was not recorded: the scenario's reference is taken, from the first answered state on",
            )
        if np.isnan(self.mismatch):
            return (f"{REFERENCE} has none of the scenario's joints: the scenario's is taken",)
        if self._since is not None and self._start is None:
            return ("the recorded reference differs from the scenario's for a moment, too short to differentiate",)
        if self._start is None:
            return ()
        other = "another reference than the scenario's was tracked: its derivatives are numerical"
        return (f"from {self._start:.3f} s on {other}",)
