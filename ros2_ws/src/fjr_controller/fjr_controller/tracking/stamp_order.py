# SPDX-License-Identifier: Apache-2.0
"""What the stamp of a sample and the time of its arrival say about its place among the others."""

from __future__ import annotations

from enum import Enum, auto


class Order(Enum):
    """Where a sample stands against the last one that was accepted."""

    FIRST = auto()
    NEXT = auto()
    REPEATED = auto()
    OLDER = auto()  # by so little, and so soon, that it only came late
    BACK = auto()  # by more than the timeout, or after nothing newer came for that long
    FORWARD = auto()  # newer by more than the timeout, though no such time has passed
    LATE = auto()  # after a silence
    DOUBTED = auto()  # as BACK or FORWARD, but no other sample confirms the jump yet


class Stamps:
    """Stamps and arrival times (of a steady clock) [ns] of the accepted samples; timeout [s].

    simulated: time is that of the stamps, which may stand still as long as they like; a pause between arrivals is
    no silence then. That nothing newer arrives where stamps are older is judged by the arrivals all the same.
    Where time is real, stamps that jump count from the second one on: the first is doubted, and forgotten when the
    stamps go on as before.
    """

    def __init__(self, timeout: float, simulated: bool = False) -> None:
        self._simulated = simulated
        self.limit(timeout)
        self.last: int | None = None
        self._arrival = 0
        self._silent = False
        self._doubted: int | None = None

    def limit(self, timeout: float) -> None:
        """Another timeout [s]."""
        self.timeout = round(timeout * 1e9)

    def judge(self, stamp: int, arrival: int) -> Order:
        """Where a sample with this stamp that arrived then stands; of it only a jump that is doubted is remembered."""
        before, self._doubted = self._doubted, None
        if self.last is None:
            return Order.FIRST
        ahead, late = stamp - self.last, arrival - self._arrival > self.timeout
        if ahead < 0 and late:
            return Order.BACK
        if ahead >= 0 and (self._silent or (late and not self._simulated)):
            return Order.LATE
        if abs(ahead) > self.timeout:
            return self._jumped(stamp, before, Order.BACK if ahead < 0 else Order.FORWARD)
        return Order.OLDER if ahead < 0 else Order.NEXT if ahead else Order.REPEATED

    def _jumped(self, stamp: int, before: int | None, order: Order) -> Order:
        """The order, if the sample before was doubted and this one follows it, or time is simulated."""
        self._doubted = stamp
        confirmed = before is not None and 0 <= stamp - before <= self.timeout
        return order if confirmed or self._simulated else Order.DOUBTED

    def accept(self, stamp: int, arrival: int) -> None:
        """The sample counts: later ones are judged by it."""
        self.last, self._arrival, self._silent = stamp, arrival, False

    def silent(self, now: int) -> bool:
        """Whether nothing has been accepted for longer than the timeout at `now` [ns]; true once for each silence.

        now: of the steady clock, or of the stamps' where time is simulated.
        """
        if self.last is None or self._silent or now - (self.last if self._simulated else self._arrival) <= self.timeout:
            return False
        self._silent = True
        return True

    def forget(self) -> None:
        """The next sample is the first."""
        self.last, self._silent, self._doubted = None, False, None
