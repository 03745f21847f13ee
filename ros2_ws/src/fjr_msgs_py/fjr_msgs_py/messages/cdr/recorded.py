# SPDX-License-Identifier: Apache-2.0
"""Read all messages of a recorded JointState topic at once, where they differ in stamps and numbers only."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array

from .layout import FIELDS, HEADER, LITTLE_ENDIAN, joint_state


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
    fixed[_STAMP] = False
    if rows[0, :HEADER].tobytes() != LITTLE_ENDIAN or (rows[:, fixed] != rows[0, fixed]).any():
        return None
    stamps = _part(rows, _STAMP, [("sec", "<i4"), ("nanosec", "<u4")])[:, 0]
    times = stamps["sec"] * np.int64(10**9) + stamps["nanosec"]
    values = {name: _part(rows, place, "<f8") for name, place in zip(FIELDS, places, strict=True)}
    return (times, values) if _is_first(times, values, first) else None


_STAMP = slice(HEADER, HEADER + 8)


def _part(rows: NDArray[np.uint8], place: slice, kind: Any) -> Any:
    return np.ascontiguousarray(rows[:, place]).view(kind)


def _is_first(times: NDArray[np.int64], values: dict[str, Array], first: Any) -> bool:
    """Return whether the first row equals the deserialised message bit by bit."""
    stamp = first.header.stamp.sec * 10**9 + first.header.stamp.nanosec
    return times[0] == stamp and all(row[0].tobytes() == bytes(getattr(first, name)) for name, row in values.items())
