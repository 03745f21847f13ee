# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers of any length: in memory while they are few, else in a scratch file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from itertools import pairwise
from tempfile import SpooledTemporaryFile, gettempdir

import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import FjrError
from fjr_core.numerics.checks import Array

IN_MEMORY = 2**24  # bytes of a table; a larger one goes to a file
BYTES = 8  # of a number
ROWS = 8192  # of a part


class ScratchError(FjrError):
    """The scratch file cannot be written."""


class Columns:
    """Columns of numbers by name, with a row for each message or state; a name may stand for one column for each joint.

    Rows are added in blocks, of which the file holds one column after the other.
    """

    def __init__(self) -> None:
        self._file = SpooledTemporaryFile(IN_MEMORY)  # noqa: SIM115 (closed in __del__)
        self._places: dict[str, int | slice] = {}
        self._width, self._begins = 0, [0]  # rows before each block, and in all

    def __del__(self) -> None:
        self._file.close()

    def __len__(self) -> int:
        return self._begins[-1]

    def add(self, **columns: Array) -> None:
        """Add rows of columns (k,) or (k, m); raise ScratchError if the disk is full."""
        self._width = 0
        for name, values in columns.items():
            end = self._width + (1 if values.ndim == 1 else values.shape[1])
            self._places[name] = self._width if values.ndim == 1 else slice(self._width, end)
            self._width = end
        try:
            self._file.seek(0, os.SEEK_END)
            self._file.write(np.column_stack(list(columns.values())).T.tobytes())
        except OSError as error:
            where = f"the scratch file of a bag in {gettempdir()}"
            raise ScratchError(f"{where} is not written: {error.strerror}; expected room there, or TMPDIR") from None
        self._begins.append(len(self) + len(values))

    def column(self, name: str, joint: int = 0) -> Array:
        """Return a whole column (k,), of those with this name the one of a joint."""
        place = self._places[name]
        return self._column(place if isinstance(place, int) else place.start + joint)

    def each(self, names: Iterable[str]) -> Iterator[Array]:
        """Yield the columns (k,) with these names, one after the other."""
        numbers = np.arange(self._width)
        return (self._column(int(place)) for name in names for place in np.atleast_1d(numbers[self._places[name]]))

    def at(self, rows: NDArray[np.integer], names: Iterable[str] = ()) -> dict[str, Array]:
        """Return rows of the columns with these names, by default of all, by their numbers; NaN for -1."""
        places = {name: self._places[name] for name in names} or self._places
        none = np.full(self._width, np.nan)
        values = {name: np.full((len(rows), *none[place].shape), np.nan) for name, place in places.items()}
        blocks = np.searchsorted(self._begins, rows, side="right") - 1
        for block in np.unique(blocks[rows >= 0]).tolist():
            here = blocks == block
            found = self._block(block, 0, self._width)[rows[here] - self._begins[block]]
            for name, place in places.items():
                values[name][here] = found[:, place]
        return values

    def parts(self) -> Iterator[dict[str, Array]]:
        """Yield all rows, ROWS at a time."""
        for begin in range(0, len(self), ROWS):
            yield self.at(np.arange(begin, min(begin + ROWS, len(self))))

    def _column(self, place: int) -> Array:
        column = np.empty(len(self))
        for i, (begin, end) in enumerate(pairwise(self._begins)):
            column[begin:end] = self._block(i, place, place + 1)[:, 0]
        return column

    def _block(self, block: int, first: int, end: int) -> Array:
        """Return the columns from `first` to `end` of a block (k, end - first)."""
        k = self._begins[block + 1] - self._begins[block]
        self._file.seek(BYTES * (self._width * self._begins[block] + k * first))
        return np.frombuffer(self._file.read(BYTES * k * (end - first))).reshape(end - first, k).T
