# SPDX-License-Identifier: Apache-2.0
"""What the tracker has to say: the state it is in, events for the log, counters for the diagnostics."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

INFO, WARN, ERROR = "info", "warn", "error"
STOPS, STARTS_REFUSED = "stops", "starts refused"  # kinds of the events that end tracking


class State(str, Enum):
    """What the tracker does with a sample."""

    WAITING = "waiting"  # for the first sample
    JOINING = "joining"  # the effort or the reference is still led from the measured state into the wanted one
    TRACKING = "tracking"
    STOPPED = "stopped"  # every sample is answered by the stop policy until resume()


@dataclass(frozen=True)
class Event:
    """Something that happened once: level info, warn or error; kind is the name of its counter."""

    level: str
    kind: str
    sentence: str
    values: Mapping[str, float | str] = field(default_factory=dict)


class Journal:
    """Events (the newest hundred that nobody has taken yet) and counters."""

    def __init__(self) -> None:
        self.events: deque[Event] = deque(maxlen=100)
        self.counters: Counter[str] = Counter()

    def say(self, level: str, kind: str, sentence: str, **values: float | str) -> None:
        """Count `kind` and leave an event."""
        self.counters[kind] += 1
        self.events.append(Event(level, kind, sentence, values))

    def count(self, kind: str) -> None:
        """Count `kind`."""
        self.counters[kind] += 1

    def take(self, other: Journal) -> None:
        """What another journal holds happened, too."""
        self.events.extend(other.events)
        self.counters.update(other.counters)
