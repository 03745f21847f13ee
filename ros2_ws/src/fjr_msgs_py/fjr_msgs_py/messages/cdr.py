# SPDX-License-Identifier: Apache-2.0
"""Layout of serialised messages (CDR), whose numbers are read and written in place.

Successive messages of a 1 kHz topic have the same names and lengths; only the stamp and the numbers change.
CDR aligns numbers relative to the end of its 4-byte header. Buffers here start 4 bytes earlier, so that the numbers
are aligned in memory, too. Padding is zero, so that equal messages are equal bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from fjr_core.numerics.checks import Array

HEADER = 4
LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # CDR header of every message written here
FIELDS = ("position", "velocity", "effort")
_STAMP, _STAMP_BYTES = struct.Struct("<iI"), slice(HEADER, HEADER + 8)


class Floats(NamedTuple):
    """A sequence of `length` numbers."""

    length: int


Part = int | str | Floats
"""Part of a message: an unsigned integer of 4 bytes, a string, or a sequence of numbers."""


class Form:
    """Layout of a serialised message: a struct format for all but the numbers, and the offsets of the numbers."""

    def __init__(self, parts: Iterable[Part]) -> None:
        """Lay out the parts. starts: of each Floats, in words of 8 bytes from HEADER bytes before the message.

        spans: bytes of the message that hold its header, integers, lengths and strings; others are numbers or padding,
        which other writers leave as it is in memory.
        """
        self.values: list[int | bytes] = []
        self.starts: list[int] = []
        self.spans = [slice(HEADER)]
        pattern, at = "<4s", 0  # `at` counts from the end of the header
        for part in parts:
            pad = -at % 4
            pattern, at = f"{pattern}{pad}xI", at + pad + 4
            self.spans.append(slice(HEADER + at - 4, HEADER + at))
            if isinstance(part, int):
                self.values.append(part)
                continue
            text = b"" if isinstance(part, Floats) else part.encode(errors="replace") + b"\0"
            self.values.append(part.length if isinstance(part, Floats) else len(text))
            if isinstance(part, Floats):
                gap = -at % 8 if part.length else 0
                self.starts.append((2 * HEADER + at + gap) // 8)
                size = gap + 8 * part.length
                pattern, at = f"{pattern}{size}x", at + size
            else:
                self.values.append(text)
                self.spans.append(slice(HEADER + at, HEADER + at + len(text)))
                pattern, at = f"{pattern}{len(text)}s", at + len(text)
        self.struct = struct.Struct(pattern)

    def empty(self) -> bytes:
        """Return the message with all numbers zero."""
        return self.struct.pack(LITTLE_ENDIAN, *self.values)


def joint_state(names: Sequence[str], lengths: Iterable[int], frame: str = "") -> Form:
    """Return the layout of a JointState; lengths: numbers of positions, velocities and efforts."""
    return Form([0, 0, frame, len(names), *names, *map(Floats, lengths)])


def float_array(label: str, length: int) -> Form:
    """Return the layout of a Float64MultiArray of one dimension."""
    return Form([1, label, length, length, 0, Floats(length)])


class Template:
    """A serialised message whose numbers and stamp are overwritten for each use."""

    def __init__(self, form: Form, lengths: Iterable[int]) -> None:
        """Allocate the message. lengths: of the sequences of numbers; `fields` holds a view of each."""
        self._buffer = bytearray(HEADER) + form.empty()
        self._bytes = memoryview(self._buffer)[HEADER:]
        self.fields = [_numbers(self._buffer, start, k) for start, k in zip(form.starts, lengths, strict=True)]

    def stamp(self, stamp: int) -> None:
        """Write the stamp [ns] into the header of the message."""
        _STAMP.pack_into(self._buffer, 2 * HEADER, *divmod(stamp, 1_000_000_000))

    def serialised(self) -> bytes:
        """Return a copy of the message, for a publisher."""
        return bytes(self._bytes)


def _numbers(buffer: bytearray, start: int, k: int) -> Array:
    """Return a view of k numbers from word `start` on."""
    return np.frombuffer(buffer, dtype="<f8", count=k, offset=8 * start) if k else np.zeros(0)


class StateLayout:
    """Layout of a serialised JointState, valid for all messages with the same names and lengths.

    stamp [ns] and values: of the last message that `taken` accepted; values[field] (k,) are views that the next
    message overwrites. moving: positions and velocities in one row, separated by a zero.
    """

    def __init__(self, data: bytes, message: JointState) -> None:
        """Derive the layout. data: a serialised message; message: its deserialised form."""
        lengths = [len(getattr(message, name)) for name in FIELDS]
        form = joint_state(message.name, lengths, message.header.frame_id)
        self._struct, self._size = form.struct, len(data)
        words = np.zeros(-(-(HEADER + self._size) // 8))
        self._copy = words.data.cast("B")[HEADER : HEADER + self._size]
        self._key = tuple(form.values[2:])
        ends = [start + k for start, k in zip(form.starts, lengths, strict=True)]
        self.values = {name: words[a:b] for name, a, b in zip(FIELDS, form.starts, ends, strict=True)}
        self.moving = words[form.starts[0] : max(ends[:2])]
        self._words, self._between = words, ends[0] if lengths[1] else 0
        self.stamp = 0
        self.trusted = self._struct.size <= self._size and self._agrees(data, message)

    def taken(self, data: bytes) -> bool:
        """Copy stamp and values of `data` and return True if it has the same names and lengths."""
        if len(data) != self._size:
            return False
        found = self._struct.unpack_from(data)
        if found[0] != LITTLE_ENDIAN or found[3:] != self._key:
            return False
        self._copy[:] = data
        self._words[self._between] = 0.0  # overwrite the length field and padding there
        self.stamp = found[1] * 1_000_000_000 + found[2]
        return True

    def _agrees(self, data: bytes, message: JointState) -> bool:
        """Return True if stamp and values read from `data` equal those of the message bit by bit."""
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        numbers = (values.tobytes() == bytes(getattr(message, name)) for name, values in self.values.items())
        return self.taken(data) and self.stamp == stamp and all(numbers)


def joint_state_arrays(messages: Sequence[bytes], first: Any) -> tuple[NDArray[np.int64], dict[str, Array]] | None:
    """Return stamps (k,) [ns] and position, velocity and effort (k, number of values) of k serialised JointStates.

    first: the first message, deserialised. None if a message has other names or lengths, or is not as this system
    writes it.
    """
    lengths = [len(getattr(first, name)) for name in FIELDS]
    form, size = joint_state(first.name, lengths, first.header.frame_id), len(messages[0])
    if form.struct.size > size or set(map(len, messages)) != {size}:
        return None
    rows = np.frombuffer(b"".join(messages), np.uint8).reshape(-1, size)
    begins = [8 * start - HEADER for start in form.starts]
    places = [slice(begin, begin + 8 * k) for begin, k in zip(begins, lengths, strict=True)]
    fixed = np.zeros(size, dtype=bool)
    for span in form.spans:
        fixed[span] = True
    fixed[_STAMP_BYTES] = False
    if rows[0, :HEADER].tobytes() != LITTLE_ENDIAN or (rows[:, fixed] != rows[0, fixed]).any():
        return None
    stamps = _part(rows, _STAMP_BYTES, [("sec", "<i4"), ("nanosec", "<u4")])[:, 0]
    times = stamps["sec"] * np.int64(10**9) + stamps["nanosec"]
    values = {name: _part(rows, place, "<f8") for name, place in zip(FIELDS, places, strict=True)}
    return (times, values) if _is_first(times, values, first) else None


def _part(rows: NDArray[np.uint8], place: slice, kind: Any) -> Any:
    return np.ascontiguousarray(rows[:, place]).view(kind)


def _is_first(times: NDArray[np.int64], values: dict[str, Array], first: Any) -> bool:
    """Return whether the first row equals the deserialised message bit by bit."""
    stamp = first.header.stamp.sec * 10**9 + first.header.stamp.nanosec
    return times[0] == stamp and all(row[0].tobytes() == bytes(getattr(first, name)) for name, row in values.items())
