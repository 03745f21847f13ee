# SPDX-License-Identifier: Apache-2.0
"""Counter-based random numbers: any run of a study can be drawn on its own.

NumPy's Philox4x64-10 (J. Salmon, M. Moraes, R. Dror, D. Shaw, SC 2011); noise.c implements the same generator.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...numerics.checks import Array

WORDS = 4
"""Random words per counter."""


def words(key: tuple[int, int], first: int, count: int) -> NDArray[np.uint64]:
    """Return the words (count, 4) at the counters first, first + 1, ...; key: two words; first < 2^256."""
    before = (first - 1) % 2**256  # NumPy increments the counter before the first block
    counter = np.array([before >> (64 * i) & (2**64 - 1) for i in range(4)], dtype=np.uint64)
    generator = np.random.Philox(key=np.array(key, dtype=np.uint64), counter=counter)
    return generator.random_raw(WORDS * count).reshape(count, WORDS)


def unit(drawn: NDArray[np.uint64]) -> Array:
    """Convert words to uniform numbers in [0, 1) with 53 bits, as NumPy does."""
    return np.asarray((drawn >> np.uint64(11)) * 2.0**-53)


def rows(key: tuple[int, int], first: int, count: int, width: int) -> NDArray[np.uint64]:
    """Return words (count, width) of the rows first .. first + count - 1; a row depends only on its number."""
    blocks = -(-width // WORDS)
    return words(key, first * blocks, count * blocks).reshape(count, blocks * WORDS)[:, :width]
