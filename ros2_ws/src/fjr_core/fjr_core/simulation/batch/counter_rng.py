# SPDX-License-Identifier: Apache-2.0
"""Random words that depend on a counter only, so that any part of a campaign can be drawn alone.

NumPy's Philox4x64-10 (J. Salmon, M. Moraes, R. Dror, D. Shaw, SC 2011); noise.c has the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...numerics.checks import Array

WORDS = 4
"""What one counter gives."""


def words(key: tuple[int, int], first: int, count: int) -> NDArray[np.uint64]:
    """The words (count, 4) at the counters first, first + 1, ...; key: two words, first: below 2^256."""
    before = (first - 1) % 2**256  # NumPy counts up before it makes the first
    counter = np.array([before >> (64 * i) & (2**64 - 1) for i in range(4)], dtype=np.uint64)
    generator = np.random.Philox(key=np.array(key, dtype=np.uint64), counter=counter)
    return generator.random_raw(WORDS * count).reshape(count, WORDS)


def unit(drawn: NDArray[np.uint64]) -> Array:
    """Uniform in [0, 1) from words, as NumPy makes it: 53 bits."""
    return np.asarray((drawn >> np.uint64(11)) * 2.0**-53)


def rows(key: tuple[int, int], first: int, count: int, width: int) -> NDArray[np.uint64]:
    """`width` words for each of the rows first .. first + count - 1: (count, width), the same whatever `first` is."""
    blocks = -(-width // WORDS)
    return words(key, first * blocks, count * blocks).reshape(count, blocks * WORDS)[:, :width]
