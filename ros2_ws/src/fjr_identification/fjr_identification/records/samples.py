# SPDX-License-Identifier: Apache-2.0
"""Samples as they were recorded, and the record of motion on a uniform grid that they make."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fjr_core.errors import RecordError
from fjr_core.numerics.checks import Array
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.uniform_grid import uniform

LARGEST = 2 * 10**7  # numbers of a record in memory


@dataclass
class Window:
    """Part of a record: from `start` [s] after its first sample for `duration` [s]. ended: nothing more follows."""

    start: float = 0.0
    duration: float = np.inf
    ended: bool = field(default=False, init=False)
    _first: float | None = field(default=None, init=False)
    _count: int = field(default=0, init=False)

    @property
    def text(self) -> str:
        """Return the window for a message; empty if it is everything."""
        return "" if self.start == 0 and np.isinf(self.duration) else f" from {self.start:g} s for {self.duration:g} s"

    def of(self, t: Array, block: Array) -> Array:
        """Return the rows of a block with the times t [s] that are in the window; raise RecordError if too many are."""
        self._first = float(t[0]) if self._first is None and len(t) else self._first
        since = t - (self._first or 0.0)
        self.ended = bool(len(t) and since[-1] >= self.start + self.duration)
        rows = np.asarray(block[(since >= self.start) & (since < self.start + self.duration)])
        self._count += rows.size
        if self._count > LARGEST:
            raise RecordError(
                f"the record holds more than {LARGEST:,} numbers; expected fewer: choose a --start and a --duration"
            )
        return rows


@dataclass(frozen=True, eq=False)
class Samples:
    """k samples of n joints in SI units at the joint side; NaN: not measured.

    t (k,) [s]. link_position, motor_position (k, n) [rad, m], effort (k, n): held from each sample to the next,
    joint_torque (k, n) [N m, N]. notes: a sentence for each thing that was substituted.
    """

    name: str
    t: Array
    link_position: Array
    motor_position: Array
    effort: Array
    joint_torque: Array
    notes: tuple[str, ...] = ()

    def on_grid(self, joints: tuple[str, ...]) -> tuple[MotionRecord, tuple[str, ...]]:
        """Return the record on a uniform grid of time, and the notes; raise RecordError."""
        n = len(joints)
        measured = np.hstack([self.link_position, self.motor_position, self.joint_torque])
        grid = uniform(self.name, self.t, self.effort, measured)
        q_l, q_m, torque = (grid.sampled[:, i * n : (i + 1) * n] for i in range(3))
        record = MotionRecord(self.name, joints, grid.dt, grid.held, q_l, q_m, torque)
        return record, tuple(f"{self.name}: {note}" for note in (*self.notes, *grid.notes))
