# SPDX-License-Identifier: Apache-2.0
"""Read the files of a bag (MCAP, SQLite, compressed by rosbag2) as far as they are readable.

An MCAP file is read from front to back: the file of a killed run (no index, no metadata.yaml, an incomplete last
record) yields everything up to the last flushed chunk, a damaged file everything but the damaged chunks. A SQLite file
is read in the same way, with or without metadata.yaml. Contents.notes lists the losses.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from fjr_monitor.recording.mcap_reader import HEAD, MAGIC, MESSAGE, UNREADABLE, File, inner, unpacked
from fjr_monitor.recording.message_types import typestore
from fjr_monitor.recording.sqlite_reader import read_tables
from fjr_monitor.recording.topic import LATEST, BagError, Contents, Messages, Topic, has_times
from fjr_msgs_py.console.output import plural


def read_mcap(path: Path, contents: Contents) -> Messages:
    """Yield the messages of an MCAP file; raise BagError."""
    before = contents.count
    with open(path, "rb") as stream:
        begin = stream.read(len(MAGIC))
        if sum(a == b for a, b in zip(begin, MAGIC, strict=False)) < min(len(begin), 6):
            raise BagError(f"{path} is not an MCAP file: it begins with other bytes")
        file = File(stream)
        reader = _McapReader(file, contents)
        yield from reader.messages()
    read = contents.count - before
    if not read and (file.damage or reader.invalid):
        raise BagError(f"{path} is not a readable MCAP file: it is damaged at byte {(file.damage or [0])[0]}")
    contents.notes += _losses(path.name, file, read, reader.invalid)
    return file.closed


def _losses(name: str, file: File, read: int, invalid: int) -> Iterator[str]:
    """Yield one sentence for each kind of loss."""
    places = [str(position) for position in sorted(set(file.damage))]
    if places:
        known = file.count is not None and file.count >= read
        lost = f"{(file.count or 0) - read} of {file.count}" if known else "an unknown number of"
        where = ", ".join(places[:3]) + (f" and {len(places) - 3} more places" if len(places) > 3 else "")
        yield f"{name} is damaged at byte {where}; {lost} messages are lost"
    if invalid:
        yield f"{name}: {plural(invalid, 'message')} of no known topic or with a time beyond 63 bits left out"


class _McapReader:
    """Sort the records of a file into topics. invalid: number of messages without a known topic or valid times."""

    def __init__(self, file: File, contents: Contents) -> None:
        self.invalid = 0
        self._file = file
        self._contents = contents
        self._schemas: dict[int, Schema] = {}
        self._topics: dict[int, Topic] = {}

    def messages(self) -> Iterator[tuple[Topic, Message]]:
        """Yield the messages in all undamaged records."""
        file, known = self._file, {*self._file.channels}
        for record in file.records(known):
            content = record.content
            try:
                if record.kind == Opcode.CHUNK:
                    yield from self._inside(unpacked(content))
                else:
                    yield from self._inside(HEAD.pack(record.kind, len(content)) + content)
            except UNREADABLE:
                file.damage.append(record.position)
            known |= self._topics.keys()

    def _inside(self, data: bytes) -> Iterator[tuple[Topic, Message]]:
        """Yield the messages among records one after the other; raise ValueError if the last is incomplete."""
        wanted, topics = self._contents.wanted, self._topics
        for kind, begin, end in inner(data):
            if kind != Opcode.MESSAGE:
                self._define(kind, data[begin:end])
                continue
            if end - begin < MESSAGE.size:
                raise ValueError("incomplete message")
            number, sequence, log_time, publish_time = MESSAGE.unpack_from(data, begin)
            topic = topics.get(number) or self._topic(number)
            if topic is None or log_time >= LATEST or publish_time >= LATEST:
                self.invalid += 1
                continue
            self._contents.count += 1
            if wanted is None or topic.name in wanted:
                yield topic, Message(number, log_time, data[begin + MESSAGE.size : end], publish_time, sequence)

    def _define(self, kind: int, content: bytes) -> None:
        if kind == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(content)))
            self._schemas[schema.id] = schema
        elif kind == Opcode.CHANNEL:
            self._open(Channel.read(ReadDataStream(BytesIO(content))))

    def _topic(self, number: int) -> Topic | None:
        """Return the topic of a channel; the summary replaces a lost channel record. None if unknown."""
        if number not in self._topics and number in self._file.channels:
            self._open(self._file.channels[number])
        return self._topics.get(number)

    def _open(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id) or self._file.schemas.get(channel.schema_id)
        if schema is not None:
            text = schema.data.decode("utf-8", "replace")
            self._topics[channel.id] = self._contents.topic(channel.topic, schema.name, text)


def read_sqlite(path: Path, contents: Contents) -> Messages:
    """Yield the messages of a SQLite file, which holds receive times only, in the order of the file."""
    before = contents.count
    if _is_cut_off(path):  # SQLite refuses such a file
        with tempfile.TemporaryDirectory() as folder:
            notes = list(contents.notes)
            yield from read_tables(_with_actual_page_count(path, Path(folder)), contents)
            contents.notes, whole = notes, False  # reported as a bag that was not closed
    else:
        whole = yield from read_tables(path, contents)
        if not whole and contents.count == before:
            contents.notes.append(f"{path.name} is damaged; no message in it can be read")
    return whole


def _is_cut_off(path: Path) -> bool:
    """Return whether a SQLite file is shorter than the page count in its header."""
    with open(path, "rb") as stream:
        header = stream.read(32)
    return len(header) == 32 and int.from_bytes(header[28:32], "big") * _page(header) > path.stat().st_size


def _page(header: bytes) -> int:
    """Return the page size [bytes]."""
    size = int.from_bytes(header[16:18], "big")
    return 2**16 if size <= 1 else size


def _with_actual_page_count(path: Path, folder: Path) -> Path:
    """Return a copy whose header holds the actual page count."""
    copy = folder / path.name
    shutil.copyfile(path, copy)
    with copy.open("r+b") as stream:
        page = _page(stream.read(32))
        pages = path.stat().st_size // page
        stream.seek(28)
        stream.write(pages.to_bytes(4, "big"))
        stream.truncate(pages * page)
    return copy


def read_compressed(folder: Path, contents: Contents) -> Messages:
    """Yield the messages of a folder compressed by rosbag2, read by the rosbags library; raise BagError."""
    from rosbags.highlevel import AnyReader  # loads its readers of ROS 1 and 2, which other bags do not need

    try:
        with AnyReader([folder], default_typestore=typestore()) as reader:
            for connection, time, data in reader.messages():
                topic = contents.topic(connection.topic, connection.msgtype, connection.msgdef.data)
                message = Message(connection.id, time, data, time, 0)
                if has_times(message):
                    contents.count += 1
                    yield topic, message
    except Exception as error:  # any error of the library
        raise BagError(f"{folder} is not a readable compressed bag: {error or type(error).__name__}") from error
    return True


COMPRESSED = re.compile(r"^\s+compression_mode: *[\"']?(file|message)\b", re.IGNORECASE | re.MULTILINE)
READERS: dict[str, Callable[[Path, Contents], Messages]] = {".mcap": read_mcap, ".db3": read_sqlite}


def files_of(path: Path) -> list[Path]:
    """Return the files of a bag, given its folder or one of its files; raise BagError."""
    if not path.exists():
        raise BagError(f"{path} does not exist; expected the folder of a bag or of a run, or an .mcap or .db3 file")
    if path.is_file():
        if path.suffix in READERS:
            return [path]
        raise BagError(f"{path} is not a bag: expected an .mcap or .db3 file, or a folder that holds some")
    if _is_compressed(path):
        return [path]
    files = sorted(file for suffix in READERS for file in path.glob(f"*{suffix}"))
    if files:
        return files
    raise BagError(f"{path} is not a bag: expected a folder with .mcap or .db3 files in it, or such a file")


def _is_compressed(folder: Path) -> bool:
    """Return whether rosbag2 compressed the files or messages of a bag; parsing all metadata would take longer."""
    try:
        text = (folder / "metadata.yaml").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return COMPRESSED.search(text) is not None


def read_file(path: Path, contents: Contents) -> Messages:
    """Yield the messages of one of files_of; topics, losses and the number of messages are added to `contents`."""
    if path.is_file() and path.stat().st_size == 0:
        return False
    return (yield from READERS.get(path.suffix, read_compressed)(path, contents))
