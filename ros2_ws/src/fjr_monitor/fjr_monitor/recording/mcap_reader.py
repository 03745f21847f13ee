# SPDX-License-Identifier: Apache-2.0
"""Read the records of an MCAP file from front to back; skip damage and verify the checksum of each chunk.

A damaged length or kind of a record loses synchronisation. Reading resumes at the next complete chunk, or at the next
message of a known channel that is followed by another record.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Container, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema, Statistics

MAGIC = b"\x89MCAP0\r\n"
HEAD, FOOTER, MESSAGE = struct.Struct("<BQ"), struct.Struct("<QQI"), struct.Struct("<HIQQ")
CHUNK = struct.Struct("<QQQII")  # begin, end, size, checksum, length of the name of the compression
COMPRESSIONS = (b"", b"lz4", b"zstd")
LARGEST_RECORD = 2**30  # bytes
MOST_EXPANSION, SMALLEST_LIMIT = 200, 2**24  # decompressed over compressed size; bytes always allowed
INDEXED = (Opcode.CHUNK, Opcode.MESSAGE_INDEX)  # records before an index
SIZES = {Opcode.FOOTER: FOOTER.size, Opcode.DATA_END: 4}
CANDIDATE = re.compile(rb"(?=[\x05\x06].{4}\0{4})", re.DOTALL)  # a message or a chunk of less than 4 GiB
BLOCK = 2**20  # bytes that are searched at a time
UNREADABLE = (McapError, struct.error, ValueError, RuntimeError, EOFError, MemoryError, zstandard.ZstdError)


@dataclass(frozen=True)
class Record:
    """A record: position of its first byte in the file, kind, content."""

    position: int
    kind: int
    content: bytes


class File:
    """An open MCAP file. closed: ends like a closed file; damage: byte positions; channels, schemas, count: summary."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.size = stream.seek(0, 2)
        self.closed = self.size > 2 * len(MAGIC) and self._bytes(self.size - len(MAGIC), len(MAGIC)) == MAGIC
        self.damage: list[int] = []
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.count: int | None = None  # messages; None: not in the summary
        self._read_summary()

    def records(self, known: Container[int]) -> Iterator[Record]:
        """Yield all records of the data section; known: channel ids, for messages outside chunks."""
        position, last = len(MAGIC), 0
        while position < self.size:
            record = self._record(position)
            if record is None or not self._is_followed(record):
                following = self._next(position + 1, known)
                if following is not None or self.closed:
                    self.damage.append(position)
                if following is None:
                    return
                position = following
                continue
            if record.kind == Opcode.DATA_END:
                self.closed = True
                self._verify(record)
                return
            if record.kind == Opcode.FOOTER:
                return
            position += HEAD.size + len(record.content)
            if last in INDEXED and record.kind == Opcode.MESSAGE and _fits(Opcode.MESSAGE_INDEX, record.content):
                continue  # a message index with a flipped bit in its kind
            yield record
            last = record.kind

    def _verify(self, end: Record) -> None:
        """Add damage that only the checksum of the data section reveals."""
        (wanted,) = struct.unpack("<I", end.content)
        if wanted and not self.damage and self._crc(0, end.position) != wanted:
            self.damage.append(end.position)

    def _crc(self, begin: int, end: int) -> int:
        checksum = 0
        for position in range(begin, end, BLOCK):
            checksum = zlib.crc32(self._bytes(position, min(BLOCK, end - position)), checksum)
        return checksum

    def _record(self, position: int) -> Record | None:
        """Return the record at a position; None if it is incomplete or invalid."""
        head = self._bytes(position, HEAD.size)
        if len(head) < HEAD.size:
            return None
        kind, length = HEAD.unpack(head)
        if length > min(LARGEST_RECORD, self.size - position - HEAD.size):
            return None
        content = self._bytes(position + HEAD.size, length)
        kind = Opcode.CHUNK if _is_chunk(content) else kind  # even with a flipped bit in its kind
        return Record(position, kind, content) if _fits(kind, content) else None

    def _is_followed(self, record: Record) -> bool:
        """Return whether a record or the end of the file follows; otherwise the length of this record is wrong."""
        if record.kind in (Opcode.CHUNK, Opcode.DATA_END, Opcode.FOOTER):
            return True
        position = record.position + HEAD.size + len(record.content)
        head = self._bytes(position, HEAD.size)
        if len(head) < HEAD.size:
            return True
        kind, length = HEAD.unpack(head)
        return not self.closed or (kind > 0 and length <= self.size - position - HEAD.size)

    def _next(self, position: int, known: Container[int]) -> int | None:
        """Return the next position of a verified record; None if there is none."""
        while position < self.size:
            block = self._bytes(position, BLOCK + HEAD.size)
            for offset in (match.start() for match in CANDIDATE.finditer(block)):
                if self._is_verified(position + offset, block[offset : offset + HEAD.size], known):
                    return position + offset
            position += BLOCK
        return None

    def _is_verified(self, position: int, head: bytes, known: Container[int]) -> bool:
        if len(head) < HEAD.size:
            return False
        kind, length = HEAD.unpack(head)
        if length > min(LARGEST_RECORD, self.size - position - HEAD.size):
            return False
        begin = self._bytes(position + HEAD.size, min(length, CHUNK.size + 16))
        if kind == Opcode.CHUNK:
            return _is_chunk(begin, length)
        following = self._bytes(position + HEAD.size + length, HEAD.size)
        if self.closed and kind == Opcode.MESSAGE and length >= MESSAGE.size and len(following) == HEAD.size:
            kind, length_after = HEAD.unpack(following)
            return MESSAGE.unpack(begin[: MESSAGE.size])[0] in known and kind in range(1, 16) and length_after < 2**32
        return False

    def _read_summary(self) -> None:
        """Read schemas, channels and message count from an undamaged summary."""
        end = self.size - len(MAGIC) - FOOTER.size
        if end < HEAD.size or self._bytes(end - HEAD.size, HEAD.size) != HEAD.pack(Opcode.FOOTER, FOOTER.size):
            return
        begin, _, checksum = FOOTER.unpack(self._bytes(end, FOOTER.size))
        if not len(MAGIC) <= begin < end or end - begin > LARGEST_RECORD:
            return
        summary = self._bytes(begin, end + FOOTER.size - 4 - begin)
        if checksum not in (0, zlib.crc32(summary)):
            return
        with suppress(*UNREADABLE):
            for kind, first, last in inner(summary[: end - HEAD.size - begin]):
                self._note(kind, ReadDataStream(BytesIO(summary[first:last])))

    def _note(self, kind: int, content: ReadDataStream) -> None:
        if kind == Opcode.SCHEMA:
            schema = Schema.read(content)
            self.schemas[schema.id] = schema
        elif kind == Opcode.CHANNEL:
            channel = Channel.read(content)
            self.channels[channel.id] = channel
        elif kind == Opcode.STATISTICS:
            self.count = Statistics.read(content).message_count

    def _bytes(self, position: int, length: int) -> bytes:
        self._stream.seek(position)
        return self._stream.read(length)


def inner(data: bytes) -> Iterator[tuple[int, int, int]]:
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
    limit = max(SMALLEST_LIMIT, MOST_EXPANSION * len(chunk.data))
    if chunk.uncompressed_size > limit:
        raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
    data = chunk.data
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            data = reader.read(chunk.uncompressed_size)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, chunk.uncompressed_size)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("wrong checksum")
    return data


def _is_chunk(content: bytes, length: int | None = None) -> bool:
    """Return whether `content` (or its beginning) has the consistent lengths of a chunk of `length` bytes."""
    if len(content) < CHUNK.size + 8:
        return False
    name_length = CHUNK.unpack_from(content)[4]
    name = content[CHUNK.size : CHUNK.size + name_length] if name_length <= 4 else b"?"
    (data,) = struct.unpack_from("<Q", content.ljust(CHUNK.size + 16, b"\0"), CHUNK.size + len(name))
    whole = len(content) if length is None else length
    return name in COMPRESSIONS and CHUNK.size + len(name) + 8 + data == whole


def _fits(kind: int, content: bytes) -> bool:
    """Return whether the content is valid for a record of this kind."""
    if kind == Opcode.CHUNK:
        return _is_chunk(content)
    if kind == Opcode.MESSAGE_INDEX:
        return len(content) >= 6 and 6 + struct.unpack_from("<HI", content)[1] == len(content)
    if kind in SIZES:
        return len(content) == SIZES[kind]
    return kind > 0 and (kind != Opcode.MESSAGE or len(content) >= MESSAGE.size)
