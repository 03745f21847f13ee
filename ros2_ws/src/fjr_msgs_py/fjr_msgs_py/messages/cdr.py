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

from fjr_core.numerics.checks import Array

HEADER = 4  # bytes, of the encapsulation
LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # CDR header of every message written here
FIELDS = ("position", "velocity", "effort")
_STAMP = slice(HEADER, HEADER + 8)  # bytes


class Floats(NamedTuple):
    """A sequence of `length` numbers."""

    length: int


Part = int | str | Floats
"""Part of a message: an unsigned integer of 4 bytes, a string, or a sequence of numbers."""


class Form:
    """Layout of a serialised message.

    empty: the message with all numbers zero. starts: of each Floats, in words of 8 bytes from HEADER bytes before the
    message; lengths: numbers of each. spans: bytes of the message that hold its header, integers, lengths and strings;
    others are numbers or padding, which other writers leave as it is in memory.
    """

    def __init__(self, parts: Iterable[Part]) -> None:
        """Lay out the parts."""
        data, self.spans = bytearray(LITTLE_ENDIAN), [slice(HEADER)]
        self.starts: list[int] = []
        self.lengths: list[int] = []
        for part in parts:
            text = part.encode(errors="replace") + b"\0" if isinstance(part, str) else b""
            count = part if isinstance(part, int) else part.length if isinstance(part, Floats) else len(text)
            data += bytes(-len(data) % 4)
            self.spans.append(slice(len(data), len(data) + 4 + len(text)))
            data += struct.pack("<I", count) + text
            if isinstance(part, Floats):
                data += bytes((HEADER - len(data)) % 8 if count else 0)
                self.starts.append((HEADER + len(data)) // 8)
                self.lengths.append(count)
                data += bytes(8 * count)
        self.empty = bytes(data)


def joint_state(names: Sequence[str], lengths: Iterable[int], frame: str = "") -> Form:
    """Return the layout of a JointState; lengths: numbers of positions, velocities and efforts."""
    return Form([0, 0, frame, len(names), *names, *map(Floats, lengths)])


def float_array(label: str, length: int) -> Form:
    """Return the layout of a Float64MultiArray of one dimension."""
    return Form([1, label, length, length, 0, Floats(length)])


def joint_state_arrays(messages: Sequence[bytes], first: Any) -> tuple[NDArray[np.int64], dict[str, Array]] | None:
    """Return stamps (k,) [ns] and position, velocity and effort (k, number of values) of k serialised JointStates.

    first: the first message, deserialised. None if a message has other names or lengths, or is not as this system
    writes it.
    """
    lengths = [len(getattr(first, name)) for name in FIELDS]
    form, size = joint_state(first.name, lengths, first.header.frame_id), len(messages[0])
    if len(form.empty) > size or set(map(len, messages)) != {size}:
        return None
    rows = np.frombuffer(b"".join(messages), np.uint8).reshape(-1, size)
    begins = [8 * start - HEADER for start in form.starts]
    places = [slice(begin, begin + 8 * k) for begin, k in zip(begins, lengths, strict=True)]
    fixed = np.zeros(size, dtype=bool)
    for span in form.spans:
        fixed[span] = True
    fixed[_STAMP] = False
    if rows[0, :HEADER].tobytes() != LITTLE_ENDIAN or (rows[:, fixed] != rows[0, fixed]).any():
        return None

    def part(place: slice, kind: Any) -> Any:
        return np.ascontiguousarray(rows[:, place]).view(kind)

    stamps = part(_STAMP, [("sec", "<i4"), ("nanosec", "<u4")])[:, 0]
    times = stamps["sec"] * np.int64(10**9) + stamps["nanosec"]
    values = {name: part(place, "<f8") for name, place in zip(FIELDS, places, strict=True)}
    same = all(row[0].tobytes() == bytes(getattr(first, name)) for name, row in values.items())
    return (times, values) if same and times[0] == first.header.stamp.sec * 10**9 + first.header.stamp.nanosec else None
