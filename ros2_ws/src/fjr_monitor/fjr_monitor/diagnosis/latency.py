# SPDX-License-Identifier: Apache-2.0
"""Estimate the delay from a state to its command when the clock of the stamps has an unknown offset."""

from __future__ import annotations

WINDOW = 1000  # states over which the clock offset is estimated


class Latency:
    """Time from each state to its command [s] without the shortest transport delay of a state.

    Arrival minus stamp is the clock offset plus the transport delay. The minimum over the last one to two WINDOWs
    estimates the offset. A constant transport delay cannot be distinguished from the clock offset and is not included;
    variations of the delay are.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Discard the estimate of the clock offset."""
        self._count, self._before, self._least = 0, float("inf"), float("inf")

    def of(self, stamp: int, arrival: int, sent: int) -> float:
        """Return the latency [s] of a state with this stamp, time of arrival and send time of its command [ns].

        arrival and sent are read from the same clock.
        """
        if self._count == WINDOW:
            self._count, self._before, self._least = 0, self._least, float("inf")
        self._count += 1
        self._least = min(self._least, arrival - stamp)
        return (sent - stamp - min(self._before, self._least)) * 1e-9
