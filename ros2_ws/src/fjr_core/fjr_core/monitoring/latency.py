# SPDX-License-Identifier: Apache-2.0
"""How long after its state an answer went, by the controller's own clock and stamps of a clock it does not know."""

from __future__ import annotations

WINDOW = 1000  # states


class Latency:
    """The time from each state to its answer [s], but for the shortest way of a state to the controller.

    Arrival less stamp is an unknown difference of clocks, plus the way of the state; the least of it over the last
    one to two WINDOWs is taken for that difference. So a way that is always as long is not in it, one that is
    longer than others is.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """The stamps begin anew."""
        self._count, self._before, self._least = 0, float("inf"), float("inf")

    def of(self, stamp: int, arrival: int, sent: int) -> float:
        """For a state with that stamp, which arrived and was answered then; all [ns], the last two by one clock."""
        if self._count == WINDOW:
            self._count, self._before, self._least = 0, self._least, float("inf")
        self._count += 1
        self._least = min(self._least, arrival - stamp)
        return (sent - stamp - min(self._before, self._least)) * 1e-9
