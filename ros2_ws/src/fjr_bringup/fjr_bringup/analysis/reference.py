# SPDX-License-Identifier: Apache-2.0
"""Reference trajectory of a bag with its four derivatives.

The scenario's reference is used where it was tracked; elsewhere the recorded one is differentiated numerically.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fjr_bringup.analysis.commands import match_stamps
from fjr_bringup.analysis.states import first_of_each_stamp
from fjr_bringup.recording.reader import Array, Bag, Times
from fjr_core.config.scenario import Scenario
from fjr_core.trajectories.reference import JETS
from fjr_msgs_py import names

REFERENCE = names.REFERENCE.replace("~", f"/{names.CONTROLLER}")
SAME = 1e-9  # rad, rad/s, relative to the size of the reference: resolution of stamps in ns
DEGREE = 5  # of the spline through the recorded velocities: its third derivative is d4q_ld


@dataclass(frozen=True)
class RecordedReference:
    """jets (k, 5, n): q_ld .. d4q_ld at k states. mismatch [rad]: recorded minus planned; NaN: unknown."""

    jets: Array
    mismatch: float
    notes: tuple[str, ...] = ()


def recorded_reference(bag: Bag, scenario: Scenario, stamp: Times, t: Array) -> RecordedReference:
    """Return the tracked reference at the stamps [ns], which are t (k,) [s] after the first state with a command."""
    planned = scenario.reference.jets(t)
    if not bag.holds(REFERENCE):
        note = f"{REFERENCE} was not recorded: the scenario's reference is taken, from the first answered state on"
        return RecordedReference(planned, np.nan, (note,))
    table = bag.joints(REFERENCE, scenario.joints)
    rows = first_of_each_stamp(table.stamp)
    place, found = match_stamps(stamp, table.stamp[rows])
    position, velocity = table.position[rows][place], table.velocity[rows][place]
    if not np.isfinite(position[found]).any():
        return RecordedReference(
            planned, np.nan, (f"{REFERENCE} has none of the scenario's joints: the scenario's is taken",)
        )
    deviation = np.abs(position - planned[:, 0]).max(axis=1)
    mismatch = float(deviation[found].max(initial=0.0))
    differs = found & ~(_same(position, planned[:, 0]) & _same(velocity, planned[:, 1]))
    if not differs.any():
        return RecordedReference(planned, mismatch)
    usable = found & np.isfinite(position).all(axis=1) & np.isfinite(velocity).all(axis=1)
    usable[: np.argmax(differs)] = False
    return _numerical(RecordedReference(planned, mismatch), t, np.flatnonzero(usable), position, velocity)


def _same(recorded: Array, planned: Array) -> NDArray[np.bool_]:
    size = 1.0 + np.abs(planned).max()
    return np.asarray((np.abs(recorded - planned) <= SAME * size).all(axis=1))


def _numerical(
    planned: RecordedReference, t: Array, rows: NDArray[np.intp], position: Array, velocity: Array
) -> RecordedReference:
    """Replace the jets from the first of `rows` on by derivatives of splines through the recorded reference."""
    if len(rows) <= DEGREE:
        note = "the recorded reference differs from the scenario's for a moment, too short to differentiate"
        return replace(planned, notes=(note,))
    from scipy.interpolate import make_interp_spline  # loaded on use: a fifth of the imports of `fjr run`

    jets, since = planned.jets.copy(), slice(rows[0], None)
    inside = np.clip(t[since], t[rows[0]], t[rows[-1]])
    jets[since, 0] = make_interp_spline(t[rows], position[rows], k=DEGREE)(inside)
    curve = make_interp_spline(t[rows], velocity[rows], k=DEGREE)
    for order in range(1, JETS):
        jets[since, order] = curve(inside, order - 1)
    start = t[rows[0]]
    note = f"from {start:.3f} s on another reference than the scenario's was tracked: its derivatives are numerical"
    return RecordedReference(jets, planned.mismatch, (note,))
