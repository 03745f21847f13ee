# SPDX-License-Identifier: Apache-2.0
"""The reference of a bag with its four derivatives: the scenario's where that was tracked, else from the recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from fjr_bringup.analysis.commands import answers
from fjr_bringup.analysis.states import first_of_each_stamp
from fjr_bringup.recording.reader import Array, Bag, Times
from fjr_core.config.scenario import Scenario
from fjr_core.trajectories.reference import JETS
from fjr_msgs_py import names

REFERENCE = names.REFERENCE.replace("~", f"/{names.CONTROLLER}")
SAME = 1e-9  # rad, rad/s, relative to the reference's own size: as equal as stamps in ns allow
DEGREE = 5  # of the spline through the recorded velocities: its third derivative is d4q_ld


@dataclass(frozen=True)
class Tracked:
    """jets (k, 5, n): q_ld .. d4q_ld at k states. mismatch [rad]: recorded against the scenario's, NaN: not known."""

    jets: Array
    mismatch: float
    notes: tuple[str, ...] = ()


def recorded_reference(bag: Bag, scenario: Scenario, stamp: Times, t: Array) -> Tracked:
    """What was tracked at the stamps [ns], which are t (k,) [s] after the first answered state."""
    planned = scenario.reference.jets(t)
    if not bag.holds(REFERENCE):
        note = f"{REFERENCE} was not recorded: the scenario's reference is taken, from the first answered state on"
        return Tracked(planned, np.nan, (note,))
    table = bag.joints(REFERENCE, scenario.joints)
    rows = first_of_each_stamp(table.stamp)
    place, found = answers(stamp, table.stamp[rows])
    position, velocity = table.position[rows][place], table.velocity[rows][place]
    if not np.isfinite(position[found]).any():
        return Tracked(planned, np.nan, (f"{REFERENCE} has none of the scenario's joints: the scenario's is taken",))
    far = np.abs(position - planned[:, 0]).max(axis=1)
    mismatch = float(far[found].max(initial=0.0))
    differs = found & ~(_same(position, planned[:, 0]) & _same(velocity, planned[:, 1]))
    if not differs.any():
        return Tracked(planned, mismatch)
    usable = found & np.isfinite(position).all(axis=1) & np.isfinite(velocity).all(axis=1)
    usable[: np.argmax(differs)] = False
    return _numerical(Tracked(planned, mismatch), t, np.flatnonzero(usable), position, velocity)


def _same(recorded: Array, planned: Array) -> NDArray[np.bool_]:
    size = 1.0 + np.abs(planned).max()
    return np.asarray((np.abs(recorded - planned) <= SAME * size).all(axis=1))


def _numerical(planned: Tracked, t: Array, rows: NDArray[np.intp], position: Array, velocity: Array) -> Tracked:
    """From the first of these rows on, where another reference was tracked: the recorded one, differentiated."""
    if len(rows) <= DEGREE:
        note = "the recorded reference differs from the scenario's for a moment, too short to differentiate"
        return replace(planned, notes=(note,))
    jets, since = planned.jets.copy(), slice(rows[0], None)
    inside = np.clip(t[since], t[rows[0]], t[rows[-1]])
    jets[since, 0] = make_interp_spline(t[rows], position[rows], k=DEGREE)(inside)
    curve = make_interp_spline(t[rows], velocity[rows], k=DEGREE)
    for order in range(1, JETS):
        jets[since, order] = curve(inside, order - 1)
    begin = t[rows[0]]
    note = f"from {begin:.3f} s on another reference than the scenario's was tracked: its derivatives are numerical"
    return Tracked(jets, planned.mismatch, (note,))
