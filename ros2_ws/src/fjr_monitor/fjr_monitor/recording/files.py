# SPDX-License-Identifier: Apache-2.0
"""Read the messages in the files of a bag (MCAP, SQLite, compressed by rosbag2) as far as they are readable.

Damage to an MCAP file costs the chunks in which it lies, to a SQLite file all messages behind it. The file of a killed
run (no index, no metadata.yaml, an incomplete last record) yields everything up to its end. `Contents.notes` lists the
losses.
"""

from __future__ import annotations

import re
import sqlite3
import struct
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Message, Schema, Statistics
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg
from zstandard import ZstdDecompressor, ZstdError

from fjr_core.errors import FjrError
from fjr_monitor.recording.message_types import deserialize, typestore
from fjr_msgs_py.console.output import plural

Times = NDArray[np.int64]
TYPE_NAME = re.compile(r"[A-Za-z]\w*/(msg|srv|action)/[A-Za-z]\w*", re.ASCII)
LONGEST_DEFINITION = 2**20  # characters
LATEST = 2**63  # ns
MAGIC = b"\x89MCAP0\r\n"
HEAD, FOOTER, MESSAGE = struct.Struct("<BQ"), struct.Struct("<QQI"), struct.Struct("<HIQQ")
LARGEST_RECORD = 2**30  # bytes
MOST_EXPANSION, SMALLEST_LIMIT = 200, 2**24  # decompressed over compressed size; bytes always allowed
BLOCK = 2**20  # bytes of a checksum that are read at a time
UNREADABLE = McapError, struct.error, ValueError, OverflowError, RuntimeError, EOFError, MemoryError, ZstdError
COMPRESSED = re.compile(r"^\s+compression_mode: *[\"']?(file|message)\b", re.IGNORECASE | re.MULTILINE)


class BagError(FjrError):
    """A bag that is missing, unreadable or without the requested topic."""


@dataclass
class Topic:
    """A topic and what a bag holds of it: the number of messages, first and last receive time [ns], lost messages.

    lost: by gaps in the sequence numbers; None with several publishers. messages: in the order they were received,
    where they were read (Bag.topic).
    """

    name: str
    type_name: str
    definition: str
    messages: list[Message] = field(default_factory=list)
    count: int = 0
    first: int = 2**63
    last: int = 0
    lost: int | None = 0
    sequence: int = 0

    def note(self, message: Message) -> None:
        """Count a message."""
        if self.count and self.lost is not None:
            step = message.sequence - self.sequence  # 0: not recorded
            self.lost = self.lost + step - 1 if step >= 1 else None
        self.sequence = message.sequence
        self.count += 1
        self.first, self.last = min(self.first, message.log_time), max(self.last, message.log_time)

    @cached_property
    def publish_time(self) -> Times:
        """Send time of each message by the middleware [ns], (k,); receive time if the bag holds no send times."""
        return np.array([message.publish_time for message in self.messages], dtype=np.int64)

    @cached_property
    def decoded(self) -> list[Any]:
        """All messages, deserialised; raise BagError for an invalid type, definition or message."""
        return self.decode(self.messages)

    def decode(self, messages: Iterable[Message]) -> list[Any]:
        """Return messages of this topic, deserialised; raise BagError as `decoded` does."""
        if not TYPE_NAME.fullmatch(self.type_name):
            raise BagError(f"{self.name} has the type {self.type_name!r}; expected one like sensor_msgs/msg/JointState")
        if len(self.definition) > LONGEST_DEFINITION:
            raise BagError(f"{self.name} has a definition of {len(self.definition)} characters; expected a message's")
        try:
            store = typestore()
            if self.type_name not in store.fielddefs:
                store.register(get_types_from_msg(self.definition, self.type_name))
            return [deserialize(message.data, self.type_name) for message in messages]
        except Exception as error:  # any error of the decoder
            raise BagError(f"{self.name} holds bytes that are not a {self.type_name} ({error})") from error


@dataclass
class Contents:
    """What the files of a bag hold so far: topics by name, number of messages, and one sentence for each loss.

    wanted: topics whose messages are needed; None: all. A reader may leave out the others. complete: all files were
    closed by the recorder.
    """

    topics: dict[str, Topic] = field(default_factory=dict)
    count: int = 0
    notes: list[str] = field(default_factory=list)
    wanted: Collection[str] | None = None
    complete: bool = True

    def topic(self, name: str, type_name: str, definition: str) -> Topic:
        """Return the topic of this name; add it if it is new."""
        return self.topics.setdefault(name, Topic(name, type_name, definition))


Messages = Iterator[tuple[Topic, Message]]
"""Messages, each with its topic."""


def files_of(path: Path) -> list[Path]:
    """Return the files of a bag, given its folder or one of its files; raise BagError."""
    if not path.exists():
        raise BagError(f"{path} does not exist; expected the folder of a bag or of a run, or an .mcap or .db3 file")
    if path.is_file():
        if path.suffix in READERS:
            return [path]
        raise BagError(f"{path} is not a bag: expected an .mcap or .db3 file, or a folder that holds some")
    with suppress(OSError):  # no metadata; parsing all of it would take longer
        if COMPRESSED.search((path / "metadata.yaml").read_text(encoding="utf-8", errors="replace")):
            return [path]
    found = (file for suffix in READERS for file in path.glob(f"*{suffix}"))
    if files := sorted(found, key=lambda file: (len(file.name), file.name)):  # number 10 behind number 9
        return files
    raise BagError(f"{path} is not a bag: expected a folder with .mcap or .db3 files in it, or such a file")


def read_mcap(path: Path, contents: Contents) -> Messages:
    """Yield the messages of an MCAP file; raise BagError."""
    before = contents.count
    with open(path, "rb") as stream:
        begin = stream.read(len(MAGIC))
        if sum(a == b for a, b in zip(begin, MAGIC, strict=False)) < min(len(begin), 6):
            raise BagError(f"{path} is not an MCAP file: it begins with other bytes")
        file = _McapFile(stream, contents)
        yield from file.messages()
    read = contents.count - before
    if not read and (file.damage or file.invalid):
        raise BagError(f"{path} is not a readable MCAP file: it is damaged at byte {(file.damage or [0])[0]}")
    contents.notes += file.losses(path.name, read)
    contents.complete &= file.closed


class _McapFile:
    """An open MCAP file. closed: it ends as a closed one; damage: byte positions; invalid: number of unusable messages.

    A file with an intact summary is read by its index of chunks, each verified by its checksum. Any other file, such as
    that of a killed recorder or one without chunks, is read from front to back up to its first incomplete record.
    """

    def __init__(self, stream: BinaryIO, contents: Contents) -> None:
        self._stream, self._contents = stream, contents
        self._size = stream.seek(0, 2)
        self.closed = self._size > 2 * len(MAGIC) and self._bytes(self._size - len(MAGIC), len(MAGIC)) == MAGIC
        self.damage: list[int] = []
        self.invalid = 0
        self._schemas: dict[int, Schema] = {}
        self._topics: dict[int, Topic] = {}
        self._index: list[ChunkIndex] = []
        self._count: int | None = None  # messages; None: not in the summary

    def messages(self) -> Messages:
        """Yield all undamaged messages."""
        summary = self._summary()
        try:
            for kind, begin, end in records(summary):
                self._define(kind, summary, begin, end)
        except UNREADABLE:
            self._index.clear()
        if not self._index:
            yield from self._in_sequence()
        for each in sorted(self._index, key=lambda index: index.chunk_start_offset):
            content = self._bytes(each.chunk_start_offset, each.chunk_length)[HEAD.size :]
            yield from self._undamaged(each.chunk_start_offset, Opcode.CHUNK, content)

    def losses(self, name: str, read: int) -> Iterator[str]:
        """Yield one sentence for each kind of loss; read: number of messages."""
        places = [str(position) for position in sorted(set(self.damage))]
        if places:
            known = self._count is not None and self._count >= read
            lost = f"{(self._count or 0) - read} of {self._count}" if known else "an unknown number of"
            where = ", ".join(places[:3]) + (f" and {len(places) - 3} more places" if len(places) > 3 else "")
            yield f"{name} is damaged at byte {where}; {lost} messages are lost"
        if self.invalid:
            yield f"{name}: {plural(self.invalid, 'message')} of no known topic or with a time beyond 63 bits left out"

    def _summary(self) -> bytes:
        """Return the records of an undamaged summary; nothing without one."""
        end = self._size - len(MAGIC) - FOOTER.size
        if end < HEAD.size or self._bytes(end - HEAD.size, HEAD.size) != HEAD.pack(Opcode.FOOTER, FOOTER.size):
            return b""
        begin, _, checksum = FOOTER.unpack(self._bytes(end, FOOTER.size))
        if not len(MAGIC) <= begin < end or end - begin > LARGEST_RECORD:
            return b""
        summary = self._bytes(begin, end + FOOTER.size - 4 - begin)
        return summary[: end - HEAD.size - begin] if checksum in (0, zlib.crc32(summary)) else b""

    def _in_sequence(self) -> Messages:
        """Yield messages from front to back."""
        position = len(MAGIC)
        while position < self._size:
            head = self._bytes(position, HEAD.size)
            kind, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, 0)
            following = position + HEAD.size + length
            if not kind or length > LARGEST_RECORD or following > self._size:
                self.damage += [position] * self.closed  # else the recorder was killed
                return
            content = self._bytes(position + HEAD.size, length)
            if kind in (Opcode.DATA_END, Opcode.FOOTER):
                self.closed |= kind == Opcode.DATA_END
                if kind == Opcode.DATA_END and not self.damage and not self._agrees(content, position):
                    self.damage.append(position)
                return
            yield from self._undamaged(position, kind, content)
            position = following

    def _agrees(self, content: bytes, end: int) -> bool:
        """Return whether the record at the end of the data has their checksum, or none."""
        wanted, checksum = int.from_bytes(content[:4], "little"), 0
        for position in range(0, end if wanted else 0, BLOCK):
            checksum = zlib.crc32(self._bytes(position, min(BLOCK, end - position)), checksum)
        return checksum == wanted

    def _undamaged(self, position: int, kind: int, content: bytes) -> Messages:
        """Yield the messages of the record at a position; note damage."""
        try:
            data = unpacked(content) if kind == Opcode.CHUNK else HEAD.pack(kind, len(content)) + content
            yield from self._inside(data)
        except UNREADABLE:
            self.damage.append(position)

    def _inside(self, data: bytes) -> Messages:
        """Yield the messages among records one after the other; raise ValueError if the last is incomplete."""
        wanted, topics = self._contents.wanted, self._topics
        for kind, begin, end in records(data):
            if kind != Opcode.MESSAGE:
                self._define(kind, data, begin, end)
                continue
            if end - begin < MESSAGE.size:
                raise ValueError("incomplete message")
            number, sequence, log_time, publish_time = MESSAGE.unpack_from(data, begin)
            topic = topics.get(number)
            if topic is None or log_time >= LATEST or publish_time >= LATEST:
                self.invalid += 1
                continue
            self._contents.count += 1
            if wanted is None or topic.name in wanted:
                yield topic, Message(number, log_time, data[begin + MESSAGE.size : end], publish_time, sequence)

    def _define(self, kind: int, data: bytes, begin: int, end: int) -> None:
        """Take a record that is not a message."""
        if kind not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK_INDEX, Opcode.STATISTICS):
            return
        content = ReadDataStream(BytesIO(data[begin:end]))
        if kind == Opcode.SCHEMA:
            schema = Schema.read(content)
            self._schemas[schema.id] = schema
        elif kind == Opcode.CHANNEL:
            channel = Channel.read(content)
            if (found := self._schemas.get(channel.schema_id)) is not None:
                text = found.data.decode("utf-8", "replace")
                self._topics[channel.id] = self._contents.topic(channel.topic, found.name, text)
        elif kind == Opcode.CHUNK_INDEX:
            self._index.append(ChunkIndex.read(content))
        else:
            self._count = Statistics.read(content).message_count

    def _bytes(self, position: int, length: int) -> bytes:
        position = min(position, self._size)  # of an index that may be damaged, as the length
        self._stream.seek(position)
        return self._stream.read(min(length, self._size - position))


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield kind, begin and end of the records in a chunk or summary; raise ValueError if the last is incomplete."""
    position, size = 0, len(data)
    while position < size:
        if size - position < HEAD.size:
            raise ValueError("incomplete record")
        kind, length = HEAD.unpack_from(data, position)
        begin = position + HEAD.size
        position = begin + length
        if position > size:
            raise ValueError("record longer than its container")
        yield kind, begin, position


def unpacked(content: bytes) -> bytes:
    """Decompress the records of a chunk; raise one of UNREADABLE for a wrong checksum or an implausible size."""
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    if chunk.uncompressed_size > max(SMALLEST_LIMIT, MOST_EXPANSION * len(chunk.data)):
        raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
    data = chunk.data
    if chunk.compression == "zstd":
        with ZstdDecompressor().stream_reader(chunk.data) as reader:
            data = reader.read(chunk.uncompressed_size)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, chunk.uncompressed_size)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("wrong checksum")
    return data


def read_sqlite(path: Path, contents: Contents) -> Messages:
    """Yield the messages of a SQLite file, which holds receive times only, up to damage; raise BagError."""
    before, invalid = contents.count, 0
    topics: dict[object, Topic] = {}
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
            database.text_factory = lambda text: text.decode("utf-8", "replace")
            kinds = dict(database.execute("SELECT name, sql FROM sqlite_master"))
            for name in ("topics", "messages"):
                if not str(kinds.get(name)).upper().startswith("CREATE TABLE"):  # a view could yield rows without end
                    raise BagError(f"{path} is not a readable SQLite bag: no such table: {name}")
            for number, topic, type_name in database.execute("SELECT id, name, type FROM topics"):
                topics[number] = contents.topic(str(topic), str(type_name), "")
            for number, time, data in database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
                if number in topics and isinstance(time, int) and isinstance(data, bytes) and 0 <= time < LATEST:
                    contents.count += 1
                    yield topics[number], Message(number, time, data, time, 0)
                else:
                    invalid += 1
    except (sqlite3.Error, OverflowError, ValueError) as error:
        if "malformed" not in str(error):
            raise BagError(f"{path} is not a readable SQLite bag: {error}") from error
        read = plural(contents.count - before, "message")
        contents.notes.append(f"{path.name} is damaged; {read} read, those behind the damage are lost")
        contents.complete = False
        return
    if invalid:
        contents.notes.append(f"{path.name}: {plural(invalid, 'message')} of no known topic or without a time left out")


def read_compressed(folder: Path, contents: Contents) -> Messages:
    """Yield the messages of a folder compressed by rosbag2, read by the rosbags library; raise BagError."""
    from rosbags.highlevel import AnyReader  # loads its readers of ROS 1 and 2, which other bags do not need

    try:
        with AnyReader([folder], default_typestore=typestore()) as reader:
            for connection, time, data in reader.messages():
                topic = contents.topic(connection.topic, connection.msgtype, connection.msgdef.data)
                if 0 <= time < LATEST:
                    contents.count += 1
                    yield topic, Message(connection.id, time, data, time, 0)
    except Exception as error:  # any error of the library
        raise BagError(f"{folder} is not a readable compressed bag: {error or type(error).__name__}") from error


READERS: dict[str, Callable[[Path, Contents], Messages]] = {".mcap": read_mcap, ".db3": read_sqlite}
