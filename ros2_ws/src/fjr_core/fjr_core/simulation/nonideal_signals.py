# SPDX-License-Identifier: Apache-2.0
"""What sensors and messages do to the numbers of a perfect robot, as plain checked values; all off by default."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..numerics import checks

NANOSECONDS = 1e9
MOST_BITS = 48.0
"""Finer steps of an encoder are no longer seen in double precision."""


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the sensors of n joints; fields are scalars or (n,), kept as (n,).

    bits_l, bits_m: encoder bits per turn of q_l and of q_m (0: no quantisation; a motor's encoder behind a gear
    of ratio r has log2 r bits more per turn of q_m, so they need not be whole). position_l, position_m [rad] and
    velocity_l, velocity_m [rad/s]: standard deviations of white noise, before the quantisation.
    velocities: whether velocities are measured at all. Raises ParameterError.
    """

    n: int
    bits_l: ArrayLike = 0.0
    bits_m: ArrayLike = 0.0
    position_l: ArrayLike = 0.0
    position_m: ArrayLike = 0.0
    velocity_l: ArrayLike = 0.0
    velocity_m: ArrayLike = 0.0
    velocities: bool = True

    def __post_init__(self) -> None:
        for field in fields(self)[1:-1]:
            array = checks.vector(field.name, getattr(self, field.name), self.n, ParameterError)
            largest = MOST_BITS if field.name.startswith("bits") else np.inf
            if not np.all((array >= 0) & (array <= largest)):
                raise ParameterError(f"{field.name} is {array.tolist()}; expected 0 to {largest}")
            array.setflags(write=False)
            object.__setattr__(self, field.name, array)

    @property
    def off(self) -> bool:
        """Whether the sensors are perfect."""
        return self.velocities and not any(np.any(getattr(self, field.name)) for field in fields(self)[1:-1])


@dataclass(frozen=True)
class ChannelErrors:
    """What happens to messages on their way: delay and jitter [s], loss and repetition (probabilities).

    An item takes delay plus a uniform share of jitter; a repeated one comes twice, the copy with a share of its
    own. in_order: no item overtakes an earlier one, as with DDS; else jitter may change the order.
    Raises ParameterError.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    repetition: float = 0.0
    in_order: bool = True

    def __post_init__(self) -> None:
        for name in ("delay", "jitter"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ParameterError(f"{name} is {getattr(self, name)} s; expected 0 or more, finite")
        for name in ("loss", "repetition"):
            if not 0 <= getattr(self, name) <= 1:
                raise ParameterError(f"{name} is {getattr(self, name)}; expected a probability, 0 to 1")

    @property
    def off(self) -> bool:
        """Whether every item arrives once and at once."""
        return not (self.delay or self.jitter or self.loss or self.repetition)
