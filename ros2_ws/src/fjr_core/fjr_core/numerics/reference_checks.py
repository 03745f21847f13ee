# SPDX-License-Identifier: Apache-2.0
"""Checks that references share: TrajectoryError, one sentence."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TrajectoryError
from . import checks
from .checks import Array


def joint_vector(name: str, value: ArrayLike) -> Array:
    """Return `value` as (n,), n at least 1."""
    array = checks.finite(name, value, TrajectoryError)
    if array.ndim != 1 or not array.size:
        raise TrajectoryError(f"{name} has shape {array.shape}; expected (n,), one number per joint")
    return array


def number(name: str, value: ArrayLike) -> float:
    """Return `value` as one finite number."""
    return float(checks.vector(name, value, 1, TrajectoryError)[0])


def positive(name: str, value: float) -> None:
    """Raise unless `value` [s] is positive and finite."""
    if not (np.isfinite(value) and value > 0):
        raise TrajectoryError(f"{name} is {value} s; expected a positive finite number")


def freeze(owner: object, name: str, array: Array) -> None:
    """Make `array`, which nobody may change, a field of the frozen `owner`."""
    array.setflags(write=False)
    object.__setattr__(owner, name, array)
