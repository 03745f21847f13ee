# SPDX-License-Identifier: Apache-2.0
"""The reference that is being followed, on the time line of the stamps."""

from __future__ import annotations

import numpy as np

from fjr_core import Reference
from fjr_core.numerics.checks import Array
from fjr_core.trajectories.point_to_point import Hold
from fjr_core.trajectories.transition import join

SHORTEST, LONGEST = 0.2, 2.0  # s; of coming to rest
MATCHED = 1e-6  # of jets against jets, relative to 1 + the largest entry of the same derivative


class RunningReference:
    """A reference with its clock: jets (5, n) for stamps [ns]; times are seconds since its zero.

    joined_at: stamp from which on it is the wanted reference and no longer a way to it.
    """

    def __init__(self, reference: Reference) -> None:
        self._target = self._reference = reference
        self._zero: int | None = None
        self._next: tuple[Reference, int | None] | None = None
        self.joined_at = 0

    @property
    def begun(self) -> bool:
        """Whether its clock runs."""
        return self._zero is not None

    @property
    def end(self) -> float:
        """Stamp [ns] from which on it stands still; inf for never or before it begins."""
        return np.inf if self._zero is None else self._zero + self._reference.end * 1e9

    def is_due(self, stamp: int) -> bool:
        """Whether something is to follow from this stamp on."""
        return self._next is not None and (self._next[1] is None or stamp >= self._next[1])

    def begin(self, stamp: int) -> None:
        """Time 0 is at this stamp; what was to follow at a stamp of another time line is dropped."""
        if self._next is not None and (self._zero is None or self._next[1] is None):
            self._target = self._next[0]
        self._next = None
        self._reference, self._zero, self.joined_at = self._target, stamp, stamp

    def jets(self, stamp: int) -> Array:
        """q_ld .. d4q_ld (5, n) at the stamp; at time 0 before it begins."""
        if self._zero is None:
            return self._reference.jets(0.0)
        return self._reference.jets((stamp - self._zero) * 1e-9)

    def join(self, jets0: Array, stamp: int, duration: float) -> None:
        """Lead from jets0 (5, n) at the stamp into the wanted reference, within duration > 0 [s]."""
        assert self._zero is not None
        self._reference = join(jets0, (stamp - self._zero) * 1e-9, self._target, duration)
        self.joined_at = stamp + round(duration * 1e9)

    def drop(self) -> None:
        """Nothing is to follow."""
        self._next = None

    def replace(self, reference: Reference, start: int | None) -> None:
        """Follow `reference`, whose time 0 is at the stamp `start` (None: the next one's), when that has come."""
        self._next = (reference, start)

    def advance(self, stamp: int, join_time: float) -> bool:
        """Take over what is to follow, if its time has come; joined within join_time [s] where it does not match."""
        if self._next is None or not self.is_due(stamp):
            return False
        reference, start = self._next[0], stamp if self._next[1] is None else self._next[1]
        fits = join_time == 0 or _match(self.jets(start), reference.jets(0.0))
        jets0 = self.jets(stamp)
        self._take(reference, start)
        if not fits:
            self.join(jets0, stamp, join_time)
        return True

    def brake(self, stamp: int, deceleration: float) -> None:
        """Come to rest from here, each joint on half the way that it would go in that time, and stand there."""
        jets0 = self.jets(stamp)
        speed = float(np.max(np.abs(jets0[1])))
        duration = min(max(speed / deceleration, SHORTEST), LONGEST)
        self.stand(jets0[0] + jets0[1] * (duration / 2), stamp)
        self.join(jets0, stamp, duration)

    def stand(self, q: Array, stamp: int) -> None:
        """Stand at q (n,) [rad]."""
        self._take(Hold(q.copy()), stamp)

    def _take(self, reference: Reference, start: int) -> None:
        self._target = self._reference = reference
        self._zero, self._next, self.joined_at = start, None, start


def _match(jets: Array, others: Array) -> bool:
    scale = 1.0 + np.max(np.abs(jets), axis=1, keepdims=True)
    return bool(np.all(np.abs(jets - others) <= MATCHED * scale))
