# SPDX-License-Identifier: Apache-2.0
"""Ranges of CasADi functions in boxes and tubes that are not verified: their values at random corners."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ...numerics.checks import Array
from .box import Box, Tube

POINTS = 3  # random corners of each box
SEED = 0


def sampled_range(function: ca.Function, *boxes: Box) -> list[Box]:
    """Return the ranges of the outputs (size, k) at random corners and the middles of k boxes (size, k)."""
    found = sampled_values(function, boxes[0].lower.shape[1], *boxes)
    values = [np.array([point.lower for point in points]) for points in zip(*found, strict=True)]
    return [Box(each.min(axis=0), each.max(axis=0)) for each in values]


def sampled_values(function: ca.Function, k: int, *arguments: Box | Tube) -> list[list[Box]]:
    """Return the outputs (size, k) in the middle of k boxes or tubes and at random corners, as points."""
    rng, mapped = np.random.default_rng(SEED), function.map(k)
    exact = all(isinstance(each, Box) and np.array_equal(each.lower, each.upper) for each in arguments)
    found = []
    for point in range(1 if exact else POINTS + 1):
        chosen = []
        for i, each in enumerate(arguments):
            rows, columns = function.size_in(i)
            size = rows * columns, k
            share = np.full(size, 0.5) if point == 0 else rng.integers(0, 2, size).astype(float)
            values = each.corners(share) if isinstance(each, Tube) else each.lower + share * (each.upper - each.lower)
            chosen.append(values.T.reshape(k, columns, rows).transpose(2, 0, 1).reshape(rows, -1))
        results = mapped(*chosen)
        results = results if isinstance(results, tuple) else (results,)
        found.append([Box.point(_columns(each.full(), function.size_out(i), k)) for i, each in enumerate(results)])
    return found


def _columns(side_by_side: Array, size: tuple[int, int], k: int) -> Array:
    """Return matrices (rows, k columns) side by side as columns (rows * columns, k)."""
    rows, columns = size
    return side_by_side.reshape(rows, k, columns).transpose(2, 0, 1).reshape(rows * columns, k)
