# SPDX-License-Identifier: Apache-2.0
"""Reports of the tracker: its state, events for the log, counters for the diagnostics."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

INFO, WARN, ERROR = "info", "warn", "error"
STOPS, STARTS_REFUSED = "stops", "starts refused"  # kinds of the events that end tracking


class State(str, Enum):
    """Operating state of the tracker."""

    WAITING = "waiting"  # for the first sample
    JOINING = "joining"  # transition from the measured state to the reference, or bumpless transfer of the effort
    TRACKING = "tracking"
    STOPPED = "stopped"  # the stop policy acts until resume()


@dataclass(frozen=True)
class Event:
    """One event: level info, warn or error; kind is the name of its counter."""

    level: str
    kind: str
    sentence: str
    values: Mapping[str, float | str] = field(default_factory=dict)


class Journal:
    """Counters, and the newest hundred unread events.

    episodes: kinds whose episode has been reported and has not ended; remove one to end its episode.
    """

    def __init__(self) -> None:
        self.events: deque[Event] = deque(maxlen=100)
        self.counters: Counter[str] = Counter()
        self.episodes: set[str] = set()

    def report(self, level: str, kind: str, sentence: str, **values: float | str) -> None:
        """Count `kind` and add an event."""
        self.counters[kind] += 1
        self.events.append(Event(level, kind, sentence, values))

    def count(self, kind: str) -> None:
        """Count `kind`."""
        self.counters[kind] += 1

    def report_episode(self, level: str, kind: str, sentence: str, **values: float | str) -> None:
        """Count `kind`; add an event only for the first call of an episode."""
        if kind in self.episodes:
            self.count(kind)
        else:
            self.episodes.add(kind)
            self.report(level, kind, sentence, **values)
