# SPDX-License-Identifier: Apache-2.0
"""Part of a box of factors with its centre motion and the tube about it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from ...numerics.checks import Array
from .centre_motion import CentreMotion

NARROWEST = 0.002
"""Width of a factor that is not divided."""


@dataclass(frozen=True, eq=False)
class Part:
    """Part of the box of factors, low to high (7,).

    centre: motion of the robot in the middle; None where none was found. effect: deviation of a position [rad] by each
    uncertain factor. first_order, ultimate, from_start (2n,): bounds of |q_l - q_ld| and |dq_l - dq_ld|: to first order
    in the factors; in the steady state; at all times for a robot that starts on the reference. The latter two are
    infinite without a tube. storage: largest V [J] in the steady state; nan if the law has none. share: width of parts
    of this one that have a tube, relative to it.
    """

    low: Array
    high: Array
    centre: CentreMotion
    effect: Array
    first_order: Array
    ultimate: Array
    from_start: Array
    storage: float = np.inf
    share: float = 0.5

    @property
    def found(self) -> bool:
        """True if the part has a tube."""
        return bool(np.all(np.isfinite(self.ultimate)))

    @property
    def size(self) -> float:
        """Largest bound of a position; infinite without a tube."""
        return float(np.max(np.split(self.ultimate, 2)[0]))

    @property
    def excess(self) -> float:
        """Ratio of the bound of the positions to that to first order in the factors; infinite without a tube."""
        found, least = (np.split(each, 2)[0] for each in (self.ultimate, self.first_order))
        return float(np.max(found / np.maximum(least, 1e-12)))

    @property
    def narrow(self) -> bool:
        """True if no factor can be divided."""
        return bool(np.all(self.high - self.low <= NARROWEST))

    def divided(self) -> list[tuple[Array, Array]]:
        """Return boxes of equal size, in which the effect of the factors on the positions is `share` of that here.

        The factor with the largest effect in a box is divided first.
        """
        width = self.high - self.low
        effect, count = np.zeros_like(width), np.ones(len(width), dtype=int)
        effect[width > 0] = self.effect
        while np.sum(effect / count) > self.share * np.sum(effect) and np.any(width / count > NARROWEST):
            count[np.argmax(np.where(width / count > NARROWEST, effect / count, -1.0))] += 1
        places = product(*(range(each) for each in count))
        lows = [self.low + width * np.array(place) / count for place in places]
        return [(low, low + width / count) for low in lows]
