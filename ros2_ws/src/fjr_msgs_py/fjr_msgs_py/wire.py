# SPDX-License-Identifier: Apache-2.0
"""Messages in their serialised form (CDR), with numbers that are read and written in place.

A message of a thousand a second has the same names and lengths each time: only its stamp and its numbers are new.
CDR aligns numbers from the end of its header of 4 bytes on; buffers here begin 4 bytes earlier, so that numbers are
where NumPy wants them.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

Array = NDArray[np.float64]

HEADER = 4
FIELDS = ("position", "velocity", "effort")
_STAMP = struct.Struct("=iI")


class Template:
    """A serialised message whose float fields, and stamp where it has one, are overwritten again and again."""

    def __init__(self, message: Any, lengths: Mapping[str, int]) -> None:
        """message: with everything else in place. lengths: of its float fields, which `fields` are views of."""
        marks = {name: _mark(i, k) for i, (name, k) in enumerate(lengths.items())}
        for name, mark in marks.items():
            setattr(message, name, mark.tolist())
        serialised = serialize_message(message)
        self._buffer = bytearray(HEADER) + serialised
        self._bytes = memoryview(self._buffer)[HEADER:]
        self.fields = [self._found(serialised, mark) for mark in marks.values()]

    def _found(self, serialised: bytes, mark: Array) -> Array:
        """The numbers, writeable, that are these now."""
        if not len(mark):
            return mark
        offset = HEADER + serialised.index(mark.tobytes())
        return np.frombuffer(self._buffer, dtype=np.float64, count=len(mark), offset=offset)

    def stamp(self, stamp: int) -> None:
        """Write the stamp [ns] of the header that the message begins with."""
        _STAMP.pack_into(self._buffer, 2 * HEADER, *divmod(stamp, 1_000_000_000))

    def serialised(self) -> bytes:
        """The message as it is now, to be published."""
        return bytes(self._bytes)


def _mark(i: int, k: int) -> Array:
    """k numbers by which field i is found."""
    return np.arange(k, dtype=np.float64) + 0.123456789 + 1e6 * (i + 1)


class StateLayout:
    """Where the numbers of a serialised JointState are, and of all others with the same names and lengths.

    stamp [ns] and values: of the last message that was `taken`; values[field] (k,) are views that the next one
    overwrites. moving: one row of the positions and velocities, with a zero between them.
    """

    def __init__(self, data: bytes, message: JointState) -> None:
        """data: a serialised message, message: the same as rclpy reads it."""
        pattern, starts = _pattern(message)
        self._pattern, self._size = struct.Struct(pattern), len(data)
        words = np.zeros(-(-(HEADER + self._size) // 8))
        self._copy = words.data.cast("B")[HEADER : HEADER + self._size]
        ends = {name: start + len(getattr(message, name)) for name, start in starts.items()}
        self.values = {name: words[start : ends[name]] for name, start in starts.items()}
        self.moving = words[starts["position"] : max(ends["position"], ends["velocity"])]
        self._words, self._between = words, ends["position"] if message.velocity else 0
        self.stamp = 0
        self._key: tuple[Any, ...] = ()
        self.trusted = self._pattern.size <= self._size and self._learn(data, message)

    def taken(self, data: bytes) -> bool:
        """Whether `data` has the same names and lengths; then its stamp and values are here."""
        if len(data) != self._size:
            return False
        found = self._pattern.unpack_from(data)
        if found[2:] != self._key:
            return False
        self._copy[:] = data
        self._words[self._between] = 0.0  # there it has a length, and bytes that mean nothing
        self.stamp = found[0] * 1_000_000_000 + found[1]
        return True

    def _learn(self, data: bytes, message: JointState) -> bool:
        """Whether what is found in `data` is the message, bit by bit."""
        self._key = self._pattern.unpack_from(data)[2:]
        texts = [part for part in self._key if isinstance(part, bytes)]
        names = [text.encode(errors="replace") + b"\0" for text in (message.header.frame_id, *message.name)]
        numbers = (values.tobytes() == bytes(getattr(message, name)) for name, values in self.values.items())
        return texts == names and self.taken(data) and all(numbers)


def _pattern(message: JointState) -> tuple[str, dict[str, int]]:
    """The format (of struct) of such a serialised message but for its numbers, and the words that these begin at."""
    pattern, at, starts = "=4xiI", 8, {}  # the stamp comes first; `at` counts from the end of the header
    for text in (message.header.frame_id, None, *message.name):
        pattern += f"{-at % 4}xI"
        at += -at % 4 + 4
        if text is not None:
            k = len(text.encode(errors="replace")) + 1
            pattern, at = pattern + f"{k}s", at + k
    for name in FIELDS:
        k = len(getattr(message, name))
        pattern += f"{-at % 4}xI"
        at += -at % 4 + 4
        gap = -at % 8 if k else 0
        starts[name] = (2 * HEADER + at + gap) // 8
        pattern, at = pattern + f"{gap + 8 * k}x", at + gap + 8 * k
    return pattern, starts
