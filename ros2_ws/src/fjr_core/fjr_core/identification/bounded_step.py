# SPDX-License-Identifier: Apache-2.0
"""Step to the minimum of a quadratic model whose parameters may be bounded by zero."""

from __future__ import annotations

import numpy as np

from ..numerics.checks import Array


def bounded_step(H: Array, g: Array, z: Array, bounded: Array, damping: float = 0.0) -> Array:
    """Return the step (p,) that maximises g' step - step' (H + damping diag H) step / 2.

    Entries that are bounded (p,) and that the step would make negative become 0, one set after the other.
    """
    step, held = np.zeros(len(z)), np.zeros(len(z), dtype=bool)
    for _ in range(len(z) + 1):
        moved = np.flatnonzero(~held)
        scale = np.sqrt(np.diag(H)[moved])
        rest = g[moved] - H[np.ix_(moved, np.flatnonzero(held))] @ step[held]
        scaled = H[np.ix_(moved, moved)] / np.outer(scale, scale) + damping * np.eye(len(moved))
        step[moved] = np.linalg.solve(scaled, rest / scale) / scale
        below = bounded & ~held & (z + step < -1e-12 * (1 + np.abs(z)))
        if not below.any():
            break
        step[below], held = -z[below], held | below
    return step
