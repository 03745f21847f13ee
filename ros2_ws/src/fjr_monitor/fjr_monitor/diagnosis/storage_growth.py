# SPDX-License-Identifier: Apache-2.0
"""Measure the growth of V beyond what hold, noise and the tolerated tracking error explain."""

from __future__ import annotations

import numpy as np

from fjr_core.monitoring.thresholds import PREDICTED
from fjr_core.numerics.checks import Array

from .innovations import Innovations
from .storage_budget import foreign

CONTINUOUS = 1e-6  # relative difference of V between the end of an interval and the start of the next


def rises(found: Innovations, limit: Array, lowest: float = np.inf, before: float = np.nan) -> Array:
    """Return V at the end of each interval and the lowest V before it (2, k) [J].

    An interval without the law's effort counts as V = 0; after it, and after a missing interval, the search for the
    lowest V starts again. lowest, before [J]: the lowest V before the first interval, and V at the end of the one
    before, infinite if the search starts again, NaN if not known. limit (n,) [N m]: of the efforts.
    """
    found_lowest, other = np.zeros(len(found)), foreign(found, limit)
    for k, (V0, V1) in enumerate(zip(found.V0.tolist(), found.V1.tolist(), strict=True)):
        lowest = V0 if abs(V0 - before) > CONTINUOUS * V0 else min(lowest, V0)
        found_lowest[k], before = lowest, np.inf if other[k] else V1
    return np.stack([np.where(other, 0.0, found.V1), found_lowest])


def highest(risen: Array) -> Array:
    """Return those of `rises` (2, k) that may be the largest ratio to the lowest V plus a floor, whatever the floor."""
    V, lowest = risen[:, np.lexsort((-risen[0], risen[1]))]
    kept = np.append(True, V[1:] > np.maximum.accumulate(V)[:-1]) if len(V) else np.zeros(0, dtype=bool)
    return np.stack([V[kept], lowest[kept]])


def floor(added: Array, decay: float, tolerated: float) -> float:
    """Return the storage [J] that hold, noise and the tolerated tracking error explain.

    added (b,) [J]: contribution of hold and noise in each block. decay: guaranteed factor of V in a block. tolerated
    [J]: storage of the tolerated error. The remainder is the level at which the decay in a block equals the lower
    quartile of the contributions. The quartile keeps a diverging loop from raising its own floor.
    """
    if not len(added):
        return tolerated
    explained = PREDICTED * float(np.quantile(np.where(np.isfinite(added), added, np.finfo(float).max), 0.25))
    return tolerated + explained / max(1 - decay, np.finfo(float).eps)


def growth(risen: Array, floor: float) -> float:
    """Return the largest ratio of V to the lowest V before it plus the floor [J]; risen (2, k) as from `rises`."""
    V, lowest = risen
    return float(np.max(V / (lowest + floor), initial=0.0))
