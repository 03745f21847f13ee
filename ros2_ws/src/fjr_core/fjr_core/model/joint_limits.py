# SPDX-License-Identifier: Apache-2.0
"""Joint limits of a robot: position, velocity and effort."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..errors import RobotError
from ..numerics.checks import Array, floats, freeze
from ..numerics.one_line import one_line


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of n joints, each (n,): positions lower, upper [rad], velocity [rad/s] and effort [N m], both > 0.

    Prismatic joints use m and N. An infinite value means no limit. Raises RobotError.
    """

    lower: Array
    upper: Array
    velocity: Array
    effort: Array

    __repr__ = one_line

    def __post_init__(self) -> None:
        for field in fields(self):
            array = _numbers(field.name, getattr(self, field.name))
            if array.shape != np.shape(self.lower):
                raise RobotError(f"{field.name} has shape {array.shape}; expected that of lower, {self.lower.shape}")
            freeze(self, field.name, array)
        if not np.all(self.lower <= self.upper):
            raise RobotError(f"lower is {self.lower.tolist()}, upper {self.upper.tolist()}; expected lower <= upper")
        for name in ("velocity", "effort"):
            if not np.all(getattr(self, name) > 0):
                raise RobotError(f"{name} limit is {getattr(self, name).tolist()}; expected positive numbers")

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.lower)


def _numbers(name: str, value: object) -> Array:
    array = floats(f"{name} limit", value, RobotError)
    if array.ndim != 1 or np.any(np.isnan(array)):
        raise RobotError(f"{name} limit is {array.tolist()}; expected one number per joint, infinite for no limit")
    return array
