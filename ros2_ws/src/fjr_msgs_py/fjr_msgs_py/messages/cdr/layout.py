# SPDX-License-Identifier: Apache-2.0
"""Messages in their serialised form (CDR), with numbers that are read and written in place.

A message of a thousand a second has the same names and lengths each time: only its stamp and its numbers are new.
CDR aligns numbers from the end of its header of 4 bytes on; buffers here begin 4 bytes earlier, so that numbers are
where NumPy wants them. What only aligns is zero, so that equal messages are equal bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

Array = NDArray[np.float64]

HEADER = 4
LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # the header of all that is written here
FIELDS = ("position", "velocity", "effort")
_STAMP = struct.Struct("<iI")


class Floats(NamedTuple):
    """A sequence of so many numbers."""

    length: int


Part = int | str | Floats
"""Of a message: an unsigned number of 4 bytes, a text, or a sequence of numbers, one after another."""


class Form:
    """Where the parts of a serialised message are: a format (of struct) for all but the numbers, and their words."""

    def __init__(self, parts: Iterable[Part]) -> None:
        """starts: of each Floats, counted in words of 8 bytes from HEADER before the message."""
        self.values: list[int | bytes] = []
        self.starts: list[int] = []
        pattern, at = "<4s", 0  # `at` counts from the end of the header
        for part in parts:
            pad = -at % 4
            pattern, at = f"{pattern}{pad}xI", at + pad + 4
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
                pattern, at = f"{pattern}{len(text)}s", at + len(text)
        self.struct = struct.Struct(pattern)

    def empty(self) -> bytes:
        """The message with all numbers zero."""
        return self.struct.pack(LITTLE_ENDIAN, *self.values)


def joint_state(names: Sequence[str], lengths: Iterable[int], frame: str = "") -> Form:
    """A JointState with these names and so many positions, velocities and efforts; its stamp comes first."""
    return Form([0, 0, frame, len(names), *names, *map(Floats, lengths)])


def float_array(label: str, length: int) -> Form:
    """A Float64MultiArray of one dimension."""
    return Form([1, label, length, length, 0, Floats(length)])


class Template:
    """A serialised message whose numbers, and stamp where it has one, are overwritten again and again."""

    def __init__(self, form: Form, lengths: Iterable[int]) -> None:
        """lengths: of the sequences of numbers, which `fields` are views of."""
        self._buffer = bytearray(HEADER) + form.empty()
        self._bytes = memoryview(self._buffer)[HEADER:]
        self.fields = [_numbers(self._buffer, start, k) for start, k in zip(form.starts, lengths, strict=True)]

    def stamp(self, stamp: int) -> None:
        """Write the stamp [ns] of the header that the message begins with."""
        _STAMP.pack_into(self._buffer, 2 * HEADER, *divmod(stamp, 1_000_000_000))

    def serialised(self) -> bytes:
        """The message as it is now, to be published."""
        return bytes(self._bytes)


def _numbers(buffer: bytearray, start: int, k: int) -> Array:
    """The k numbers (a view) from a word on."""
    return np.frombuffer(buffer, dtype="<f8", count=k, offset=8 * start) if k else np.zeros(0)


class StateLayout:
    """Where the numbers of a serialised JointState are, and of all others with the same names and lengths.

    stamp [ns] and values: of the last message that was `taken`; values[field] (k,) are views that the next one
    overwrites. moving: one row of the positions and velocities, with a zero between them.
    """

    def __init__(self, data: bytes, message: JointState) -> None:
        """data: a serialised message, message: the same as rclpy reads it."""
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
        """Whether `data` has the same names and lengths; then its stamp and values are here."""
        if len(data) != self._size:
            return False
        found = self._struct.unpack_from(data)
        if found[0] != LITTLE_ENDIAN or found[3:] != self._key:
            return False
        self._copy[:] = data
        self._words[self._between] = 0.0  # there it has a length, and bytes that mean nothing
        self.stamp = found[1] * 1_000_000_000 + found[2]
        return True

    def _agrees(self, data: bytes, message: JointState) -> bool:
        """Whether what is found in `data` is the message, bit by bit."""
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        numbers = (values.tobytes() == bytes(getattr(message, name)) for name, values in self.values.items())
        return self.taken(data) and self.stamp == stamp and all(numbers)
