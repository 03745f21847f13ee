# SPDX-License-Identifier: Apache-2.0
"""The order of samples, from their stamps and times of arrival: late, repeated, jumped, or after a silence."""

from __future__ import annotations

from enum import Enum, auto


class Order(Enum):
    """Position of a sample relative to the last accepted one."""

    FIRST = auto()
    NEXT = auto()
    REPEATED = auto()
    OLDER = auto()  # by less than the timeout, soon after a newer one: delivered late
    BACK = auto()  # by more than the timeout, or after nothing newer arrived for that long
    FORWARD = auto()  # newer by more than the timeout, although less time has passed
    LATE = auto()  # after a silence
    DOUBTED = auto()  # BACK or FORWARD, not yet confirmed by another sample


class Stamps:
    """Stamps and arrival times (steady clock) [ns] of the accepted samples, with the timeout [ns].

    A stamp that jumped back by more than the timeout, or an older one after nothing newer arrived for that long, starts
    another time line (a robot that was reset, a bag that loops). A stamp that jumped forward, or a sample after a
    silence, ends a gap of the same time line.
    Without simulated time a jump counts from its second sample on: the first is unconfirmed, and is discarded if the
    stamps continue as before. With simulated time a jump counts at once, and a pause between arrivals is no silence,
    because the stamps are the time; whether an older sample is late is still decided by the arrivals.
    """

    def __init__(self, timeout: float, simulated: bool = False) -> None:
        self._simulated = simulated
        self.set_timeout(timeout)
        self.last: int | None = None
        self._arrival = 0
        self._silent = False
        self._unconfirmed: int | None = None

    def set_timeout(self, timeout: float) -> None:
        """Replace the timeout [s]."""
        self.timeout = round(timeout * 1e9)

    def classify(self, stamp: int, arrival: int) -> Order:
        """Return the order of a sample by its stamp and arrival [ns]; only an unconfirmed jump is stored."""
        before, self._unconfirmed = self._unconfirmed, None
        if self.last is None:
            return Order.FIRST
        ahead, late = stamp - self.last, arrival - self._arrival > self.timeout
        if ahead < 0 and late:
            return Order.BACK
        if ahead >= 0 and (self._silent or (late and not self._simulated)):
            return Order.LATE
        if abs(ahead) > self.timeout:
            return self._jump(stamp, before, Order.BACK if ahead < 0 else Order.FORWARD)
        return Order.OLDER if ahead < 0 else Order.NEXT if ahead else Order.REPEATED

    def accept(self, stamp: int, arrival: int) -> int:
        """Accept the sample; return the time since the last one by the stamps [ns], from 0 to the timeout."""
        elapsed = 0 if self.last is None else min(max(stamp - self.last, 0), self.timeout)
        self.last, self._arrival, self._silent = stamp, arrival, False
        return elapsed

    def silent(self, now: int) -> bool:
        """Return True once per silence, if no sample was accepted for longer than the timeout at `now` [ns].

        now: of the steady clock; with simulated time, of the clock of the stamps.
        """
        if self.last is None or self._silent or now - (self.last if self._simulated else self._arrival) <= self.timeout:
            return False
        self._silent = True
        return True

    def reset(self) -> None:
        """Treat the next sample as the first."""
        self.last, self._silent, self._unconfirmed = None, False, None

    def _jump(self, stamp: int, before: int | None, order: Order) -> Order:
        """Return the order if the sample follows an unconfirmed jump, or time is simulated; DOUBTED otherwise."""
        self._unconfirmed = stamp
        confirmed = before is not None and 0 <= stamp - before <= self.timeout
        return order if confirmed or self._simulated else Order.DOUBTED
