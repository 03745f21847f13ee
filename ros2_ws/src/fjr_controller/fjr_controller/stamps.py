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
    LATE = auto()  # after a silence by the arrival clock


class Stamps:
    """Stamps and arrival times (of a steady clock) [ns] of the accepted samples; timeout [s].

    simulated: time is that of the stamps, which may stand still as long as they like; a pause between arrivals is
    no silence then. That nothing newer arrives where stamps are older is judged by the arrivals all the same.
    """

    def __init__(self, timeout: float, simulated: bool = False) -> None:
        self._simulated = simulated
        self.limit(timeout)
        self.last: int | None = None
        self._arrival = 0
        self._silent = False

    def limit(self, timeout: float) -> None:
        """Another timeout [s]."""
        self.timeout = round(timeout * 1e9)

    def judge(self, stamp: int, arrival: int) -> Order:
        """Where a sample with this stamp that arrived then stands; nothing is remembered."""
        last = self.last
        if last is None:
            return Order.FIRST
        late = arrival - self._arrival > self.timeout
        if stamp < last:
            return Order.BACK if late or last - stamp > self.timeout else Order.OLDER
        if late and not self._simulated:
            return Order.LATE
        if stamp - last > self.timeout:
            return Order.FORWARD
        return Order.NEXT if stamp > last else Order.REPEATED

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
        self.last, self._silent = None, False
