# SPDX-License-Identifier: Apache-2.0
"""Read topics and messages of a SQLite bag; skip damaged pages."""

from __future__ import annotations

import sqlite3
from collections.abc import Generator
from contextlib import closing
from pathlib import Path

from mcap.records import Message

from fjr_monitor.recording.topic import BagError, Contents, Messages, Topic, has_times
from fjr_msgs_py.console.output import plural

MESSAGES = "SELECT id, topic_id, timestamp, data FROM messages WHERE id >= ? ORDER BY id"
MOST_GAPS = 100


def read_tables(path: Path, contents: Contents) -> Messages:
    """Yield all readable messages; return False if some are damaged. Raise BagError if it is not a SQLite bag."""
    try:
        with closing(_opened(path)) as database:
            reader = _Reader(database, contents)
            return (yield from reader.read(path.name))
    except (sqlite3.Error, OverflowError, ValueError) as error:
        if "malformed" in str(error):
            return False
        raise BagError(f"{path} is not a readable SQLite bag: {error}") from error


def _opened(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
    database.text_factory = lambda text: text.decode("utf-8", "replace")
    kinds = dict(database.execute("SELECT name, sql FROM sqlite_master WHERE name IN ('topics', 'messages')"))
    for name in ("topics", "messages"):
        if not str(kinds.get(name)).upper().startswith("CREATE TABLE"):  # a view could yield rows without end
            database.close()
            raise BagError(f"{path} is not a readable SQLite bag: no such table: {name}")
    return database


class _Reader:
    """Read one database; count invalid messages and damaged places."""

    def __init__(self, database: sqlite3.Connection, contents: Contents) -> None:
        self._database = database
        self._contents = contents
        self._topics: dict[int, Topic] = {}
        self._invalid = self._gaps = 0

    def read(self, name: str) -> Messages:
        """Yield all readable messages; return whether nothing was damaged."""
        for number, topic, type_name in self._database.execute("SELECT id, name, type FROM topics"):
            self._topics[number] = self._contents.topic(str(topic), str(type_name), "")
        following: int | None = -(2**63)
        while following is not None:
            following = yield from self._read_from(following)
        notes = self._contents.notes
        if self._gaps:
            notes.append(f"{name} is damaged in {plural(self._gaps, 'place')}; the messages there are lost")
        if self._invalid:
            notes.append(f"{name}: {plural(self._invalid, 'message')} of no known topic or without a time left out")
        return not self._gaps

    def _read_from(self, first: int) -> Generator[tuple[Topic, Message], None, int | None]:
        """Yield messages from id `first` on; return the id after a damaged page, None at the end."""
        last = first - 1
        try:
            for row in self._database.execute(MESSAGES, (first,)):
                last = yield from self._message(*row)
        except sqlite3.DatabaseError as error:
            if "malformed" not in str(error):
                raise
            while (row := self._one(last + 1)) is not None:  # the cursor reads ahead of the rows it yields
                last = yield from self._message(*row)
            self._gaps += 1
            return self._next_after(max(last, 0)) if self._gaps < MOST_GAPS else None
        return None

    def _next_after(self, last: int) -> int | None:
        """Find the least readable id after `last` by doubling, then bisection; None if there is none."""
        step = 1
        while self._one(last + step) is None:
            step *= 2
            if step > 2**32:
                return None
        low, high = step // 2, step
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self._one(last + middle) else (middle, high)
        return last + high

    def _one(self, number: int) -> tuple[int, object, object, object] | None:
        """Return the first message from an id on; None if it is unreadable."""
        try:
            return self._database.execute(f"{MESSAGES} LIMIT 1", (number,)).fetchone()
        except sqlite3.DatabaseError:
            return None

    def _message(
        self, number: int, topic: object, time: object, data: object
    ) -> Generator[tuple[Topic, Message], None, int]:
        """Yield a message if it is valid; return its id."""
        if isinstance(topic, int) and topic in self._topics and isinstance(time, int) and isinstance(data, bytes):
            message = Message(topic, time, data, time, 0)
            if has_times(message):
                self._contents.count += 1
                yield self._topics[topic], message
                return number
        self._invalid += 1
        return number
