# SPDX-License-Identifier: Apache-2.0
"""Read a bag of any size: first what it holds, then its messages one by one by receive time."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import Message

from fjr_bringup.recording.formats import files_of, read_file
from fjr_bringup.recording.reader import bag_folder
from fjr_bringup.recording.topic import Contents, Topic

AHEAD_MESSAGES, AHEAD_BYTES = 10_000, 2**26
"""What is read ahead, and sorted, at most: the first limit that is reached counts."""


@dataclass
class Held:
    """What a bag holds of one topic: its type, the number of messages, first and last receive time [ns]."""

    type_name: str
    count: int = 0
    first: int = 2**63
    last: int = 0


@dataclass
class Overview(Contents):
    """What a bag holds, without its messages; held: by topic, those with messages only."""

    held: dict[str, Held] = field(default_factory=dict)

    def note(self, topic: Topic, message: Message) -> None:
        """Count a message."""
        found = self.held.setdefault(topic.name, Held(topic.type_name))
        found.count += 1
        found.first, found.last = min(found.first, message.log_time), max(found.last, message.log_time)


def overview(path: Path) -> Overview:
    """Return what a bag holds, given its folder, one of its files or the folder of a run; raise BagError."""
    found = Overview()
    for file in files_of(bag_folder(path)):
        for topic, message in read_file(file, found):
            found.note(topic, message)
    return found


def in_order(path: Path, names: Collection[str]) -> Iterator[tuple[str, Message]]:
    """Yield topic and message of the named topics by receive time; raise BagError.

    Messages are sorted as far as AHEAD_MESSAGES and AHEAD_BYTES reach; recorders write them almost sorted.
    """
    ahead: list[tuple[int, int, str, Message]] = []
    size = 0
    for number, (name, message) in enumerate(_as_stored(path, names)):
        heapq.heappush(ahead, (message.log_time, number, name, message))
        size += len(message.data)
        while len(ahead) > AHEAD_MESSAGES or (size > AHEAD_BYTES and len(ahead) > 1):
            *_, name, message = heapq.heappop(ahead)
            size -= len(message.data)
            yield name, message
    while ahead:
        *_, name, message = heapq.heappop(ahead)
        yield name, message


def _as_stored(path: Path, names: Collection[str]) -> Iterator[tuple[str, Message]]:
    """Yield the messages of the named topics in the order of the files."""
    contents = Contents()
    for file in files_of(bag_folder(path)):
        for topic, message in read_file(file, contents):
            if topic.name in names:
                yield topic.name, message
