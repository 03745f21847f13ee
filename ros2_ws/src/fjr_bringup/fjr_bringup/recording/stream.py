# SPDX-License-Identifier: Apache-2.0
"""Read a bag of any size: first what it holds, then its messages one by one by receive time."""

from __future__ import annotations

import heapq
import threading
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, Full, Queue

from mcap.records import Message

from fjr_bringup.recording.formats import files_of, read_file
from fjr_bringup.recording.reader import bag_folder
from fjr_bringup.recording.topic import Contents, Topic

AHEAD_MESSAGES, AHEAD_BYTES = 10_000, 2**26
"""What is read ahead, and sorted, at most: the first limit that is reached counts."""
WAIT = 0.1  # s between looks at whether the other side has ended


@dataclass
class Held:
    """What a bag holds of one topic: its type, the number of messages, first and last receive time [ns]."""

    type_name: str
    count: int = 0
    first: int = 2**63
    last: int = 0


@dataclass
class Overview(Contents):
    """Read a bag without keeping its messages; held: by topic, those with messages only."""

    held: dict[str, Held] = field(default_factory=dict)

    def add(self, topic: Topic, message: Message) -> None:
        """Count a message."""
        found = self.held.setdefault(topic.name, Held(topic.type_name))
        found.count += 1
        found.first, found.last = min(found.first, message.log_time), max(found.last, message.log_time)

    @property
    def count(self) -> int:
        """Number of messages read."""
        return sum(found.count for found in self.held.values())


def overview(path: Path) -> Overview:
    """Return what a bag holds, given its folder, one of its files or the folder of a run; raise BagError."""
    found = Overview()
    for file in files_of(bag_folder(path)):
        read_file(file, found)
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
    """Yield the messages of the named topics in the order of the files, read by a thread."""
    reader = _Reader(path, names)
    reader.start()
    try:
        while (item := reader.next()) is not None:
            yield item
    finally:
        reader.closed.set()
        reader.join()
    if reader.error is not None:
        raise reader.error


class _ClosedError(Exception):
    """Nobody wants further messages."""


class _Reader(threading.Thread):
    """Read a bag into a short queue. closed: set it to end early; error: why reading ended early."""

    def __init__(self, path: Path, names: Collection[str]) -> None:
        super().__init__(name="bag reader", daemon=True)
        self.closed = threading.Event()
        self.error: Exception | None = None
        self._path = path
        self._queue: Queue[tuple[str, Message]] = Queue(100)
        self._contents = _Passed(self, names)

    def run(self) -> None:
        try:
            for file in files_of(bag_folder(self._path)):
                read_file(file, self._contents)
        except Exception as error:
            self.error = None if self.closed.is_set() else error

    def put(self, name: str, message: Message) -> None:
        """Hand a message over once the queue has room; raise _ClosedError if nobody wants it."""
        while not self.closed.is_set():
            try:
                return self._queue.put((name, message), timeout=WAIT)
            except Full:
                pass
        raise _ClosedError

    def next(self) -> tuple[str, Message] | None:
        """Return the next message; None after the last one."""
        while True:
            ended = not self.is_alive()  # before the queue is found empty
            try:
                return self._queue.get(block=not ended, timeout=WAIT)
            except Empty:
                if ended:
                    return None


class _Passed(Contents):
    """Hand messages of some topics over instead of keeping them."""

    def __init__(self, reader: _Reader, names: Collection[str]) -> None:
        super().__init__()
        self._reader = reader
        self._names = names
        self._count = 0

    def add(self, topic: Topic, message: Message) -> None:
        self._count += 1
        if topic.name in self._names:
            self._reader.put(topic.name, message)

    @property
    def count(self) -> int:
        return self._count
