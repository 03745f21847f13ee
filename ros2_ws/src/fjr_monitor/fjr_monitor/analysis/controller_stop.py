# SPDX-License-Identifier: Apache-2.0
"""Find in a bag when and why the controller stopped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fjr_core.runtime.events import STARTS_REFUSED, STOPS
from fjr_msgs_py.node.reports import STAMP

HEADINGS = {STOPS: "The controller stopped at {:.3g} s", STARTS_REFUSED: "The controller did not start"}


@dataclass(frozen=True)
class ControllerStop:
    """A stop of the controller. at_s [s]: time since the start of the run; heading: event; reason: one sentence."""

    at_s: float
    heading: str
    reason: str

    @property
    def sentence(self) -> str:
        """Heading and reason."""
        return f"{self.heading}: {self.reason}"


class StopWatch:
    """The first stop among the events of a controller, at the time of the last state before it.

    events: each with its send time [ns]. An event without a stamp is assigned to the last state sent before it.
    """

    def __init__(self, events: Sequence[tuple[Any, int]]) -> None:
        first: tuple[Any, int] = next((each for each in events if each[0].name in HEADINGS), (None, 0))
        self._event, when = first
        pairs = {} if self._event is None else {pair.key: pair.value for pair in self._event.values}
        self._stamped = STAMP in pairs
        self._when = int(pairs.get(STAMP, when))
        self._at = 0.0

    def add(self, stamps: Any, sent: Any, t: Any) -> None:
        """Take states: stamps and send times (k,) [ns], and times t (k,) [s] since the start of the run."""
        before = (stamps if self._stamped else sent) <= self._when
        self._at = float(t[before][-1]) if before.any() else self._at

    def stop(self) -> ControllerStop | None:
        """Return the stop; None if the controller never stopped."""
        if self._event is None:
            return None
        _, _, reason = self._event.message.partition(": ")
        return ControllerStop(self._at, HEADINGS[self._event.name].format(self._at), reason)
