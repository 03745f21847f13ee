# SPDX-License-Identifier: Apache-2.0
"""The reference that is tracked, on the time line of the stamps."""

from __future__ import annotations

import numpy as np

from fjr_core import Reference
from fjr_core.numerics.checks import Array
from fjr_core.trajectories.point_to_point import Hold
from fjr_core.trajectories.transition import transition

SHORTEST, LONGEST = 0.2, 2.0  # s; duration of braking
MATCHED = 1e-6  # difference of two jets, relative to 1 + the largest entry of the same derivative


class ActiveReference:
    """A reference with its clock: jets (5, n) at stamps [ns]; its own time is in seconds since its zero.

    transition_end: stamp [ns] from which on the jets are those of the requested reference.
    """

    def __init__(self, reference: Reference) -> None:
        self._target = self._reference = reference
        self._zero: int | None = None
        self._next: tuple[Reference, int | None] | None = None
        self.transition_end = 0

    @property
    def begun(self) -> bool:
        """Return True if its clock runs."""
        return self._zero is not None

    @property
    def end(self) -> float:
        """Return the stamp [ns] from which on the reference is constant; inf for never, or before it begins."""
        return np.inf if self._zero is None else self._zero + self._reference.end * 1e9

    def is_due(self, stamp: int) -> bool:
        """Return True if another reference begins at this stamp [ns]."""
        return self._next is not None and (self._next[1] is None or stamp >= self._next[1])

    def begin(self, stamp: int) -> None:
        """Set time 0 to this stamp [ns]; discard a requested reference whose start is on another time line."""
        if self._next is not None and (self._zero is None or self._next[1] is None):
            self._target = self._next[0]
        self._next = None
        self._reference, self._zero, self.transition_end = self._target, stamp, stamp

    def jets(self, stamp: int) -> Array:
        """Return q_ld .. d4q_ld (5, n) at the stamp [ns]; at time 0 before the reference begins."""
        if self._zero is None:
            return self._reference.jets(0.0)
        return self._reference.jets((stamp - self._zero) * 1e-9)

    def begin_transition(self, jets0: Array, stamp: int, duration: float) -> None:
        """Begin a transition of duration > 0 [s] from jets0 (5, n) at the stamp [ns] into the requested reference."""
        assert self._zero is not None
        self._reference = transition(jets0, (stamp - self._zero) * 1e-9, self._target, duration)
        self.transition_end = stamp + round(duration * 1e9)

    def drop(self) -> None:
        """Discard a requested reference that has not begun."""
        self._next = None

    def replace(self, reference: Reference, start: int | None) -> None:
        """Request a reference whose time 0 is at the stamp `start` [ns]; None: at the next sample."""
        self._next = (reference, start)

    def advance(self, stamp: int, join_time: float) -> None:
        """Begin a requested reference at its start, with a transition over join_time [s] unless it matches.

        It matches if its jets at time 0 equal those of the active reference to MATCHED.
        """
        if self._next is None or not self.is_due(stamp):
            return
        reference, start = self._next[0], stamp if self._next[1] is None else self._next[1]
        matches = join_time == 0 or _match(self.jets(start), reference.jets(0.0))
        jets0 = self.jets(stamp)
        self._take(reference, start)
        if not matches:
            self.begin_transition(jets0, stamp, join_time)

    def brake(self, stamp: int, deceleration: float) -> None:
        """Bring each joint to standstill over dq T / 2, T = max |dq| / deceleration within SHORTEST to LONGEST [s]."""
        jets0 = self.jets(stamp)
        speed = float(np.max(np.abs(jets0[1])))
        duration = min(max(speed / deceleration, SHORTEST), LONGEST)
        self.stand(jets0[0] + jets0[1] * (duration / 2), stamp)
        self.begin_transition(jets0, stamp, duration)

    def stand(self, q: Array, stamp: int) -> None:
        """Hold the constant position q (n,) [rad] from the stamp [ns] on."""
        self._take(Hold(q.copy()), stamp)

    def _take(self, reference: Reference, start: int) -> None:
        self._target = self._reference = reference
        self._zero, self._next, self.transition_end = start, None, start


def _match(jets: Array, others: Array) -> bool:
    scale = 1.0 + np.max(np.abs(jets), axis=1, keepdims=True)
    return bool(np.all(np.abs(jets - others) <= MATCHED * scale))
