# SPDX-License-Identifier: Apache-2.0
"""A record of a run: what was measured and sent at each instant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import StateError
from fjr_core.motions.reference import JETS
from fjr_core.numerics.checks import Array, positive
from fjr_core.numerics.one_line import joints, span

LEAD = 2
"""States of the part before that a part of a record repeats: an interval needs the effort before it."""
PART = 8192
"""States of a part: what one pass over a record holds in memory."""


@dataclass(frozen=True)
class Record:
    """Measured states and commands at k instants.

    t (k,) [s]: time stamps. position, velocity (k, 2n) [rad, rad/s]: links, then motors. jets (k, 5, n): reference.
    u (k, n) [N m]: command for each state, NaN: none. u_applied (k, n) [N m]: measured effort of the motors at each
    state, or None. sent, answered (k,) [s]: send times of states and commands, or None. sample_period [s].
    effort_limit (n,) [N m]: inf for none. lockstep: the robot waits for each command, so that send times carry no
    information. begin: states that repeat the end of the part before, at most LEAD; 0: of a whole record or its first
    part.
    Raises StateError for wrong shapes and a sample period that is not positive.
    """

    t: Array
    position: Array
    velocity: Array
    jets: Array
    u: Array
    u_applied: Array | None
    sent: Array | None
    answered: Array | None
    sample_period: float
    effort_limit: Array
    lockstep: bool = False
    begin: int = 0

    def __repr__(self) -> str:
        n = joints(self.u.shape[1])
        return f"Record({n}, {len(self.t)} instants, {span(self.t)}, sample_period={self.sample_period:.4g} s)"

    def __post_init__(self) -> None:
        k, n = np.shape(self.u) if np.ndim(self.u) == 2 else (-1, -1)
        shapes = {"t": (k,), "position": (k, 2 * n), "velocity": (k, 2 * n), "jets": (k, JETS, n), "u": (k, n)}
        optional = {"u_applied": (k, n), "sent": (k,), "answered": (k,)}
        shapes |= {name: shape for name, shape in optional.items() if getattr(self, name) is not None}
        for name, shape in {**shapes, "effort_limit": (n,)}.items():
            if np.shape(getattr(self, name)) != shape:
                raise StateError(f"{name} has shape {np.shape(getattr(self, name))}; expected {shape}")
        positive("sample_period", self.sample_period, StateError)

    def rows(self, rows: slice | NDArray[np.intp], begin: int = 0) -> Record:
        """Return the selected states; begin: of the result."""
        taken = {name: getattr(self, name) for name in SERIES}
        kept: dict[str, Any] = {name: None if each is None else each[rows] for name, each in taken.items()}
        return replace(self, begin=begin, **kept)

    def parts(self, size: int = PART) -> Iterator[Record]:
        """Yield the record in parts of `size` states, each with the last LEAD states of the one before."""
        for start in range(0, len(self.t), size):
            begin = min(LEAD, start)
            yield self.rows(slice(start - begin, start + size), begin)


SERIES = ("t", "position", "velocity", "jets", "u", "u_applied", "sent", "answered")


class Ends:
    """The first and the last states of a record that comes in parts; most: how many of each."""

    def __init__(self, most: int) -> None:
        self._most, self._first, self._last = most, 0, 0
        self._parts: list[Record] = []
        self._tail: list[Record] = []

    def add(self, part: Record) -> None:
        """Add the new states of a part."""
        k, plain = len(part.t), Record(**{f.name: getattr(part, f.name) for f in fields(Record)})
        split = min(k, part.begin + self._most - self._first)
        if split > part.begin:
            self._parts.append(plain.rows(slice(part.begin, split)))
            self._first += split - part.begin
        if k > split:
            self._tail.append(plain.rows(slice(split, k)))
            self._last += k - split
        while self._tail and self._last - len(self._tail[0].t) >= self._most:
            self._last -= len(self._tail.pop(0).t)

    def record(self) -> Record:
        """Return these states as one record."""
        every = [*self._parts, *self._tail]
        series = {name: [getattr(each, name) for each in every] for name in SERIES}
        joined: dict[str, Any] = {
            name: None if each[0] is None else np.concatenate(each) for name, each in series.items()
        }
        whole: Record = replace(every[0], **joined)
        excess = max(0, self._last - self._most)
        return whole.rows(np.r_[: self._first, self._first + excess : len(whole.t)]) if excess else whole
