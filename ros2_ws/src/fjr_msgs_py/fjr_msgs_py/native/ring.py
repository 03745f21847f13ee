# SPDX-License-Identifier: Apache-2.0
"""Records of a native loop for Python: a queue without locks, see ring.h."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.c_library import record_type

from .program import Program


class Ring:
    """A queue of records from a native loop to Python; `pointer` is a struct fjr_ring*."""

    def __init__(self, program: Program, kind: str, capacity: int) -> None:
        """kind: type of a record in C; capacity: number of records, a power of 2."""
        ffi = program.ffi
        self._program, self._type = program, record_type(ffi, ffi.typeof(kind))
        self._slots, self._taken = (np.zeros(capacity, self._type) for _ in range(2))
        self._views = [ffi.from_buffer("uint8_t[]", each.view(np.uint8)) for each in (self._slots, self._taken)]
        given = {"slots": self._views[0], "capacity": capacity, "record": self._type.itemsize}
        self.pointer = ffi.new("struct fjr_ring*", given)

    def take(self, most: int | None = None) -> NDArray[Any]:
        """Return the waiting records, the oldest first, valid until the next call; most: at most so many."""
        most = len(self._taken) if most is None else min(most, len(self._taken))
        return self._taken[: self._program.lib.fjr_ring_take(self.pointer, self._views[1], most)]

    @property
    def lost(self) -> int:
        """Number of records that found no place so far."""
        return int(self._program.lib.fjr_ring_lost(self.pointer))
