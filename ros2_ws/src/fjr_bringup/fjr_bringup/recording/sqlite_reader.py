# SPDX-License-Identifier: Apache-2.0
"""Topics and messages of a SQLite bag, past pages that are damaged."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from mcap.records import Message

from fjr_bringup.formatting import plural
from fjr_bringup.recording.topic import BagError, Contents, Topic, has_times

MESSAGES = "SELECT id, topic_id, timestamp, data FROM messages WHERE id >= ? ORDER BY id"
MOST_GAPS = 100


def read_tables(path: Path, contents: Contents) -> bool:
    """Add what can be read; false where something is damaged or missing. Raises BagError for what is no SQLite bag."""
    try:
        with closing(_opened(path)) as database:
            reader = _Reader(database, contents)
            return reader.read(path.name)
    except (sqlite3.Error, OverflowError, ValueError) as error:
        if "malformed" in str(error):
            return False
        raise BagError(f"{path} is not a readable SQLite bag: {error}") from error


def _opened(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
    database.text_factory = lambda text: text.decode("utf-8", "replace")
    kinds = dict(database.execute("SELECT name, sql FROM sqlite_master WHERE name IN ('topics', 'messages')"))
    for name in ("topics", "messages"):
        if not str(kinds.get(name)).upper().startswith("CREATE TABLE"):  # a view might never end
            database.close()
            raise BagError(f"{path} is not a readable SQLite bag: no such table: {name}")
    return database


class _Reader:
    """Reads one database; counts the messages that fit nowhere and the places that are damaged."""

    def __init__(self, database: sqlite3.Connection, contents: Contents) -> None:
        self._database = database
        self._contents = contents
        self._topics: dict[int, Topic] = {}
        self._strange = self._gaps = 0

    def read(self, name: str) -> bool:
        """Read all that can be; whether that was everything."""
        for number, topic, type_name in self._database.execute("SELECT id, name, type FROM topics"):
            self._topics[number] = self._contents.topic(str(topic), str(type_name), "")
        following: int | None = -(2**63)
        while following is not None:
            following = self._read_from(following)
        if self._gaps:
            self._contents.notes.append(
                f"{name} is damaged in {plural(self._gaps, 'place')}; the messages there are lost"
            )
        if self._strange:
            self._contents.notes.append(
                f"{name}: {plural(self._strange, 'message')} of no known topic or without a time left out"
            )
        return not self._gaps

    def _read_from(self, first: int) -> int | None:
        """Read messages from a number on; return the number after a damaged page, None where there is no more."""
        last = first - 1
        try:
            for row in self._database.execute(MESSAGES, (first,)):
                last = self._add(*row)
        except sqlite3.DatabaseError as error:
            if "malformed" not in str(error):
                raise
            while (row := self._one(last + 1)) is not None:  # the cursor had looked further than it told
                last = self._add(*row)
            self._gaps += 1
            return self._next_after(max(last, 0)) if self._gaps < MOST_GAPS else None
        return None

    def _next_after(self, last: int) -> int | None:
        """The least number after `last` from which a message can be read, found by doubling and halving."""
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
        """The first message from a number on; None where it cannot be read."""
        try:
            row: tuple[int, object, object, object] | None
            row = self._database.execute(f"{MESSAGES} LIMIT 1", (number,)).fetchone()
            return row
        except sqlite3.DatabaseError:
            return None

    def _add(self, number: int, topic: object, time: object, data: object) -> int:
        """Add a message; return its number."""
        if isinstance(topic, int) and topic in self._topics and isinstance(time, int) and isinstance(data, bytes):
            message = Message(topic, time, data, time, 0)
            if has_times(message):
                self._topics[topic].messages.append(message)
                return number
        self._strange += 1
        return number
